"""VQ and CPCA, of which noise-resistant-fitting says "similar results", and CPCA's norm, which nothing bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import clrelight as cr
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.fit import collect_fit, prepare_fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.reproduction.parts import Part, prose, table
from datasets_synth.ring import render_ring

SIZE, LIGHTS, DEGREE = 128, 256, 6
METHODS = {"uls": "ULS", "sloan": "Sloan ULS", "cls": "CLS", "ceb": "CEB"}
CODECS = {
    "S3TC": ("s3tc", {}),
    "VQ, blocks of 4×4, 8 bits": ("vq", {"bits": 8, "block": 4}),
    "VQ, whole vectors, 10 bits": ("vq", {"bits": 10}),
    "CPCA, 16 clusters, 8 axes": ("cpca", {"clusters": 16, "components": 8, "bits": 8}),
    "CPCA, 4 clusters, 4 axes": ("cpca", {"clusters": 4, "components": 4, "bits": 8}),
}
CPCA_AXES = (1, 2, 4, 8, 16, 32)
"""More than 49 coefficients of three channels need."""


def vector_codecs(device: Device) -> Part:
    """Return the table of PSNR after each codec, and of the norm that CPCA leaves."""
    stack = render_ring(size=SIZE, lights=LIGHTS)
    lines, psnr, norms = [], {}, {}

    def quality(coefficients: CoefficientMap) -> float:
        return summarize_errors(measure_errors(coefficients, stack, device=device)).psnr_mean

    fits = {}
    for method, title in METHODS.items():
        fits[method] = collect_fit(prepare_fit(stack, method, DEGREE, device=device))
        cells = [title, f"{_norm(fits[method].coeffs_khwc):.3g}", f"{quality(fits[method]):.2f}"]
        for name, (codec, options) in CODECS.items():
            decoded = _coded(fits[method], codec, options, device)
            psnr[method, name] = quality(decoded)
            cells.append(f"{psnr[method, name]:.2f}")
        lines.append(cells)
    rows = []
    for axes in CPCA_AXES:
        cells = [str(axes)]
        for method in ("uls", "cls"):
            options = {"clusters": 4, "components": axes, "bits": 16}
            decoded = _coded(fits[method], "cpca", options, device)
            norms[method, axes] = _norm(decoded.coeffs_khwc) / _norm(fits[method].coeffs_khwc)
            cells += [f"{_norm(decoded.coeffs_khwc):.4g}", f"{norms[method, axes]:.3f}", f"{quality(decoded):.2f}"]
        rows.append(cells)
    text = [
        '### VQ and CPCA ("similar results", section III-B)',
        "",
        f"Mean PSNR in dB of the ring ({SIZE}², {LIGHTS} lights, {(DEGREE + 1) ** 2} coefficients) at its lights.",
        "",
        table(["fit", "mean ‖c‖²", "plain", *CODECS], lines),
        "",
        "### CPCA does not bound the norm (section V-E)",
        "",
        prose("""Clustered principal components of coefficients that are there already: 4 clusters, weights of 16
        bits. The share of ‖c‖² that is left grows to 1 with the axes, whatever the norm is; of ULS the
        first few hold nearly all of it and little of the picture."""),
        "",
        table(
            ["axes", "ULS: mean ‖c‖²", "of its own", "PSNR", "CLS: mean ‖c‖²", "of its own", "PSNR"],
            rows,
        ),
    ]
    verdicts = {
        f"{name}: CLS and CEB are ahead of ULS": min(psnr["cls", name], psnr["ceb", name]) > psnr["uls", name]
        for name in CODECS
    }
    verdicts["a few axes of CPCA keep 90% of ULS's squared norm"] = norms["uls", 4] > 0.9
    return Part("VQ and CPCA", "\n".join(text), {what: bool(holds) for what, holds in verdicts.items()})


def _coded(coefficients: CoefficientMap, codec: str, options: dict[str, Any], device: Device) -> CoefficientMap:
    encoded = cr.encode(coefficients, codec, out=None, device=device, report=cr.Report(), **options)
    return cr.decode(encoded, device=device, report=cr.Report())


def _norm(coeffs_khwc: NDArray) -> float:
    return float(np.mean(np.sum(coeffs_khwc.astype(np.float64) ** 2, axis=0)))
