"""The noise-resistant fitting paper's three scenes: its PSNRs before and after coding, and figures of them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from clrelight.codec import codec_class
from clrelight.experiment.grid import PAPER_METHODS, PAPER_RATES, CodecSetting, Experiment
from clrelight.experiment.run import run_experiment
from clrelight.fit import method_class
from clrelight.report import paper
from clrelight.report.canvas import Page
from clrelight.report.charts import figure_7, figure_15
from clrelight.report.contact_sheet import picture_psnr
from clrelight.report.paper_figures import figure_1, figure_of_method
from clrelight.report.rows import rows_by_key, scene_names, scene_rows
from clrelight.reproduction.rows import LONG, Bench, Between, Found, Near, Row, Work
from clrelight.results import Results

RING, SURFACE = 128, 64
LIGHTS = 256
SHOWN = {"none": "32 bit", "half": "half", "s3tc": "S3TC", "uniform@8": "uniform 8 bit", "wavelet@4": "wavelet 4 bit"}
RING_FIGURES = {"uls": 4, "sloan": 8, "cls": 12}
TITLES = {"uls": "ULS", "sloan": "Sloan ULS", "cls": "CLS", "ceb": "CEB"}
_OTHER_RING = (
    "the paper's ring is not published; ours has hard shadows and highlights, which 49 coefficients do not hold, so "
    "that all fits are lower alike"
)
_BETTER_CODER = "our wavelet coder has an entropy coder and needs fewer bits for smooth maps; the noise comes at 1 bit"


def run_scene(scene: str, size: int, bench: Bench) -> tuple[Results, str]:
    """Return the results of a scene at degree 6 by the paper's methods and codecs, and its name in them."""
    codecs = [CodecSetting(), *(CodecSetting(codec_class(name)()) for name in ("half", "s3tc"))]
    codecs.append(CodecSetting(codec_class("uniform")(bits=8)))  # type: ignore[call-arg]
    codecs += [CodecSetting(codec_class("wavelet")(rate=rate)) for rate in PAPER_RATES]  # type: ignore[call-arg]
    experiment = Experiment(
        (scene,),
        tuple(method_class(method)() for method in PAPER_METHODS),
        (paper.DEGREE,),
        tuple(codecs),
        synth={scene: {"size": size, "lights": LIGHTS}},
    )
    with tempfile.TemporaryDirectory() as folder:
        results = run_experiment(experiment, Path(folder) / "results.h5", device=bench.open_device())
    return results, scene_names(results)[0]


def _measure(scene: str, size: int, bench: Bench) -> Found:
    results, name = run_scene(scene, size, bench)
    values: dict[str, float] = {}
    for (method, _, setting), row in rows_by_key(scene_rows(results, name)).items():
        label = "@".join(filter(None, setting))
        values[f"{method} {label}"] = float(row["psnr_mean"])
        values[f"{method} energy"] = float(row["mean_energy"])
    plain = {method: values[f"{method} none"] for method in PAPER_METHODS}
    for key in [key for key in values if not key.endswith(("none", "energy"))]:
        values[f"{key} fall"] = plain[key.split()[0]] - values[key]
    values["cls loses"] = plain["uls"] - plain["cls"]
    values["energy ratio"] = values["uls energy"] / values["cls energy"]
    values["sloan ratio"] = values["sloan energy"] / values["cls energy"]
    rates = [f"wavelet@{rate:g}" for rate in PAPER_RATES]
    values["least lead"] = min(values[f"cls {rate}"] - values[f"uls {rate}"] for rate in rates)
    values["lead at 2"] = values["cls wavelet@2"] - values["uls wavelet@2"]
    return Found(values, _draw(scene, results, name) if bench.draws else {})


def _draw(scene: str, results: Results, name: str) -> dict[str, Any]:
    if scene == "ring":
        return {
            **{f"fitting_figure{number}.jpg": _strip(results, name, method) for method, number in RING_FIGURES.items()},
            "fitting_figure7.png": figure_7(results, name, paper.DEGREE),
            "fitting_figure15.png": figure_15(results, name, paper.DEGREE),
        }
    drawn = {"fitting_figure1.jpg": figure_1(results, name, paper.DEGREE)} if scene == "torus" else {}
    for method, number in paper.FIGURES[scene].items():
        figure = figure_of_method(results, name, paper.DEGREE, method)
        if figure is not None:
            drawn[f"fitting_figure{number}.jpg"] = figure
    return drawn


def _strip(results: Results, name: str, method: str) -> Any:
    """Return figure 4, 8 or 12: the ring as a method fits it, then coded, side by side."""
    reference = results.pictures[f"{name}/reference"]
    side, gap = 240, 8
    page = Page(len(SHOWN) * (side + gap) + gap, side + 42)
    for column, (setting, label) in enumerate(SHOWN.items()):
        picture = results.pictures[f"{name}/{method}/{paper.DEGREE}/{setting}"]
        x = gap + column * (side + gap)
        axes = page.add_axes(x, 32, side, side)
        axes.imshow(picture, interpolation="nearest")
        axes.set_axis_off()
        page.write(x, 22, f"{TITLES[method]}, {label}: {picture_psnr(picture, reference)}", fontsize=6.5)
    return page.figure


def _table_rows(ours: Mapping[str, tuple[float, float]]) -> tuple[Row, ...]:
    rows = [
        Row("table I", f"{TITLES[method]}, PSNR in dB", f"{printed:.2f}", "table I", f"{method} none",
            Near(printed, 0.5), Near(ours[method][0], 0.7), _OTHER_RING)
        for method, printed in paper.TABLE_I.items()
    ]  # fmt: skip
    rows.append(Row("table I", "CLS is behind ULS by, dB", "0.89", "table I", "cls loses", Near(0.89, 0.6)))
    for method, (plain, coded) in paper.TABLE_III.items():
        title = TITLES[method]
        rows.append(Row("table III", f"{title}, plain, PSNR in dB", f"{plain:.2f}", "table III", f"{method} none",
                        Near(plain, 0.5), Near(ours[method][0], 0.7), _OTHER_RING))  # fmt: skip
        rows.append(Row("table III", f"{title} after S3TC, PSNR in dB", f"{coded:.2f}", "table III",
                        f"{method} s3tc", Near(coded, 0.5), Near(ours[method][1], 1.5), _OTHER_RING))  # fmt: skip
        fall = plain - coded
        sloan = "Sloan's deletion leaves ‖c‖² of hundreds at n = 49 on our ring, as the paper says it would"
        rows.append(Row("table III", f"{title} loses by S3TC, dB", f"{fall:.2f}", "table III", f"{method} s3tc fall",
                        Near(fall, 3.5), Near(ours[method][0] - ours[method][1], 2.0), sloan))  # fmt: skip
    return tuple(rows)


RING_ROWS = (
    *_table_rows({"uls": (25.7, 9.9), "sloan": (25.7, 13.4), "cls": (25.3, 23.2), "ceb": (25.2, 23.5)}),
    Row("figure 4", "ULS loses by half floats, dB", "artifacts observable", "figure 4b", "uls half fall",
        Between(0.02, 3.0)),
    Row("figure 4", "ULS loses by uniform quantization, 8 bits, dB", "unacceptable", "figure 4", "uls uniform@8 fall",
        Between(6.0, 30.0)),
    Row("figure 4", "ULS loses by wavelets, 4 bits, dB", "unacceptable", "figure 4", "uls wavelet@4 fall",
        Between(6.0, 30.0)),
    Row("figure 7", "‖c‖² of ULS over that of CLS", "very large", "figure 7a, c", "energy ratio", Between(1000.0)),
    Row("figure 7", "‖c‖² of Sloan ULS over that of CLS", "still very large", "figure 7b, c", "sloan ratio",
        Between(20.0)),
    Row("figure 8", "Sloan ULS loses by half floats, dB", "suppressed", "figure 8b", "sloan half fall",
        Between(-0.01, 0.05)),
    Row("figure 8", "Sloan ULS loses by uniform quantization, 8 bits, dB", "annoying", "figure 8",
        "sloan uniform@8 fall", Between(3.0, 30.0)),
    Row("figure 12", "CLS loses by half floats, dB", "suppressed", "figure 12", "cls half fall", Between(-0.05, 0.05)),
    Row("figure 12", "CLS loses by uniform quantization, 8 bits, dB", "suppressed", "figure 12",
        "cls uniform@8 fall", Between(-0.05, 0.3)),
    Row("figure 12", "CLS loses by wavelets, 4 bits, dB", "suppressed", "figure 12", "cls wavelet@4 fall",
        Between(-0.05, 0.3)),
    Row("figure 15", "CLS is ahead of ULS at every rate, by at least, dB", "yes", "figure 15", "least lead",
        Between(0.5), Between(-0.5, 0.5),
        "at 8 bits our coder's noise no longer shows, and ULS is ahead by what CLS gives up"),
    Row("figure 15", "CLS is ahead of ULS at 2 bits by, dB", "ULS still very low", "figure 15", "lead at 2",
        Between(5.0)),
    Row("figure 15", "CEB loses at 2 bits, dB", "slightly affected", "figure 15", "ceb wavelet@2 fall",
        Between(-0.05, 2.0)),
)  # fmt: skip


def _surface_rows(scene: str) -> tuple[Row, ...]:
    numbers = paper.FIGURES[scene]
    uls, sloan, cls = (f"figure {numbers[method]}" for method in ("uls", "sloan", "cls"))
    return (
        Row(uls, f"{scene}: ULS loses by uniform quantization, 8 bits, dB", "serious artifacts", uls,
            "uls uniform@8 fall", Between(6.0, 40.0)),
        Row(uls, f"{scene}: ULS loses by wavelets, 4 bits, dB", "serious artifacts", uls, "uls wavelet@4 fall",
            Between(6.0, 40.0), Between(-0.05, 6.0), _BETTER_CODER),
        Row(uls, f"{scene}: ULS loses by wavelets, 1 bit, dB", "serious artifacts (at 4)", uls, "uls wavelet@1 fall",
            Between(6.0, 40.0), Between(1.0, 40.0), _BETTER_CODER),
        Row(sloan, f"{scene}: Sloan ULS loses by uniform quantization, 8 bits, dB", "slightly suppressed", sloan,
            "sloan uniform@8 fall", Between(1.0, 20.0)),
        Row(cls, f"{scene}: CLS loses by uniform quantization, 8 bits, dB", "suppressed", cls, "cls uniform@8 fall",
            Between(-0.05, 0.5)),
        Row(cls, f"{scene}: CLS loses by wavelets, 4 bits, dB", "suppressed", cls, "cls wavelet@4 fall",
            Between(-0.05, 0.5)),
    )  # fmt: skip


def _pictures(scene: str) -> dict[str, str]:
    return {f"fitting_figure{number}.jpg": f"figure {number}" for number in paper.FIGURES[scene].values()}


FIGURE_1_ROWS = (
    Row("figure 1", "torus: ULS loses by wavelets, 1 bit, dB", "serious artifact (at 4)", "figure 1b",
        "uls wavelet@1 fall", Between(6.0, 40.0), Between(1.0, 40.0), _BETTER_CODER),
    Row("figure 1", "torus: CLS loses by wavelets, 1 bit, dB", "pleasant (at 4)", "figure 1c", "cls wavelet@1 fall",
        Between(-0.05, 0.5)),
)  # fmt: skip
"""The paper's own scene, of which a torus is the nearest of ours, is not published."""

WORKS = (
    Work("ring", RING_ROWS, partial(_measure, "ring", RING), takes=LONG, surfaces=True,
         pictures={**{f"fitting_figure{number}.jpg": f"figure {number}" for number in RING_FIGURES.values()},
                   "fitting_figure7.png": "figure 7",
                   "fitting_figure15.png": "figure 15"}),
    Work("torus", (*FIGURE_1_ROWS, *_surface_rows("torus")), partial(_measure, "torus", SURFACE), takes=LONG,
         surfaces=True, pictures={"fitting_figure1.jpg": "figure 1", **_pictures("torus")}),
    Work("dama", _surface_rows("dama"), partial(_measure, "dama", SURFACE), takes=LONG, surfaces=True,
         pictures=_pictures("dama")),
)  # fmt: skip
