"""The page in a headless Chromium: what it shows is a float relight by the program, and it asks nobody for anything."""

import base64
import json
import threading

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.device import open_device
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.lighting.light import Light
from clrelight.lighting.relighting import relight_under
from clrelight.store import read_fit, write_fit
from clrelight.view.lights import read_surroundings
from clrelight.view.session import served_viewer
from tests.browser import find_chromium, opened_browser
from tests.commands import succeed
from tests.reference.basis import real_harmonics

pytestmark = pytest.mark.skipif(not find_chromium(), reason="no Chromium is installed: apt-get install chromium")

SIDE = 256
LAMP = (-0.4, 0.5, 0.768)
SHOWN = """(async () => {
  const app = clrelight.app;
  app.canvas.style.cssText = "position: fixed; left: 0; top: 0; width: SIDEpx; height: SIDEpx";
  app.ratio = 1;
  app.resize();
  CHANGES;
  const ready = () => app.view.zoom === 1 && app.view.width === SIDE && app.isWhole && app.store.isIdle && !app.planned;
  for (let i = 0; i < 1000 && !ready(); i++) await new Promise((done) => setTimeout(done, 10));
  app.drawnFiles().forEach((file, slot) =>
    app.renderer.sum(slot, file, app.view, app.store, app.lighting, app.state, 1));
  const { values } = app.renderer.read(SLOT);
  let text = "";
  for (const byte of new Uint8Array(values.buffer)) text += String.fromCharCode(byte);
  return btoa(text);
})()"""


PATH = "['environment', 'turn']"


def smooth_fit(side, degree=2, seed=0):
    """Return coefficients of a bumpy picture, by its light from above and the sides."""
    y, x = np.mgrid[:side, :side] / side * 2 * np.pi
    rng = np.random.default_rng(seed)
    coeffs = np.zeros(((degree + 1) ** 2, side, side, 3), np.float32)
    for k in range(len(coeffs)):
        for c in range(3):
            waves = np.sin(rng.integers(1, 9) * x + rng.random()) * np.cos(rng.integers(1, 9) * y + c)
            coeffs[k, ..., c] = 1.4 + 0.5 * waves if k == 0 else 0.5 * waves / np.sqrt(k)
    return cr.CoefficientMap(
        coeffs, degree, "spline", 1.0, "srgb", np.array([[0.0, 0.0, 1.0], LAMP / np.linalg.norm(LAMP)])
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("page")
    write_fit(place / "fit.h5", smooth_fit(SIDE))
    # At finer steps the curve costs more than it saves, and the encoder leaves it out.
    for name, step, transfer in (("klt", 0.004, "linear"), ("curved", 0.16, "srgb")):
        words = ("--codec", "klt", "--step", step, "--transfer", transfer)
        succeed("encode", place / "fit.h5", place / f"{name}.h5", *words)
    probe = np.random.default_rng(1).random((16, 32, 3)).astype(np.float32) ** 4
    oiio.ImageBuf(probe).write(str(place / "probe.exr"))
    return place


@pytest.fixture(scope="module")
def page(folder):
    """Lend a page on disk with all files in it."""
    files = [folder / name for name in ("fit.h5", "klt.h5", "curved.h5")]
    succeed("view", *files, "--environment", folder / "probe.exr", "--out", folder / "viewer.html")
    with opened_browser((folder / "viewer.html").as_uri(), width=700, height=700) as opened:
        opened.wait("globalThis.clrelight?.app?.isWhole", 60)
        assert opened.evaluate("clrelight.app.store.files.map((file) => Boolean(file.bent))") == [False, False, True]
        yield opened


def shown(page, changes="", slot=0, side=SIDE):
    """Return linear radiance of what the page shows after changes of its state."""
    code = SHOWN.replace("SIDE", str(side)).replace("CHANGES", changes.replace("PATH", PATH)).replace("SLOT", str(slot))
    values = np.frombuffer(base64.b64decode(page.evaluate(code, 120)), np.float32).reshape(side, side, 4)[::-1]
    np.testing.assert_array_equal(values[..., 3], 1.0)
    return values[..., :3]


def lamp(first, direction=LAMP, softness=0):
    unit = (np.asarray(direction) / np.linalg.norm(direction)).tolist()
    return (
        f"Object.assign(app.state, {{ light: 'lamp', first: {first}, compare: 'one' }}); "
        f"app.state.lamp = {{ direction: {json.dumps(unit)}, softness: {softness} }}; app.changed()"
    )


def decibels(found, expected):
    return -10 * np.log10(np.mean((found - expected) ** 2))


@pytest.mark.parametrize("first", [0, 1, 2])
@pytest.mark.parametrize("direction", [LAMP, (0.1, -0.9, 0.2)])
def test_a_lamp(page, folder, first, direction):
    expected = cr.relight(folder / ("fit.h5", "klt.h5", "curved.h5")[first], direction)
    assert expected.std() > 0.05
    # 45 dB are asked for.
    assert decibels(shown(page, lamp(first, direction)), expected) > 60


def test_light_from_everywhere(page, folder):
    fit, device = read_fit(folder / "fit.h5"), open_device()
    made, _ = read_surroundings(folder / "probe.exr", 12, open_device)
    table = np.frombuffer(base64.b64decode(made["table"]), "<f4").astype(float).reshape(-1, 3)
    state = "Object.assign(app.state, { light: 'environment', first: 0, standing: %s }); app.set(PATH, 70)"
    for standing in (False, True):
        turned = cr.rotate_light(Light(table), rotation_matrix("axis", (0, 0, 1, 70.0)))
        if standing:  # zenith up in the picture, what was forward behind it
            turned = cr.rotate_light(turned, rotation_matrix("axis", (1, 0, 0, -90.0)))
        expected = relight_under(fit, turned, device=device)
        assert expected.std() > 0.05
        assert decibels(shown(page, state % str(standing).lower()), expected) > 60


@pytest.mark.parametrize("slow", [False, True])
def test_light_from_everywhere_behind_a_curve(page, folder, slow):
    """Where frames would take long, coefficients are made of a tile once, by the page's workers."""
    decoded = cr.decode(folder / "curved.h5")
    made, _ = read_surroundings(folder / "probe.exr", 12, open_device)
    table = np.frombuffer(base64.b64decode(made["table"]), "<f4").astype(float).reshape(-1, 3)
    expected = relight_under(decoded, Light(table), device=open_device())
    assert expected.std() > 0.05
    state = "Object.assign(app.state, { light: 'environment', first: 2, standing: false, compare: 'one' });"
    state += f"app.isSlow = {str(slow).lower()}; app.pace = 0; app.set(PATH, 0)"
    assert decibels(shown(page, state), expected) > 55
    if slow:
        drawn = "app = clrelight.app; app.drawnFiles().map((file) => file === app.store.files[2].straight)"
        assert page.evaluate(drawn) == [True]


def test_a_sky_and_its_sun(page, folder):
    fit = read_fit(folder / "fit.h5")
    sky = cr.sky_light("clear", 35.0, 120.0, degree=12)
    scaled = Light(0.5 * sky.coeffs_kc / (sky.coeffs_kc[0, 0] * np.sqrt(4 * np.pi)))
    sun = np.radians(35.0), np.radians(120.0)
    direction = np.array([np.cos(sun[0]) * np.cos(sun[1]), np.cos(sun[0]) * np.sin(sun[1]), np.sin(sun[0])])
    expected = relight_under(fit, scaled, device=open_device()) + 0.5 * cr.relight(fit, direction)
    state = (
        "Object.assign(app.state, { light: 'sky', first: 0, standing: false }); app.state.lamp.softness = 0;"
        "app.state.sky = { table: 0, height: 35, azimuth: 120, sun: 0.5 }; app.changed()"
    )
    assert decibels(shown(page, state), expected) > 60


@pytest.mark.parametrize(("slow", "least"), [(False, 40), (True, 60)])
def test_a_soft_lamp_behind_a_curve_is_that_of_the_coefficients(page, folder, slow, least):
    middle = np.array([0.1, 0.2, 0.97]) / np.linalg.norm([0.1, 0.2, 0.97])
    directions = np.random.default_rng(0).standard_normal((200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    mean_k = real_harmonics(directions[directions @ middle > np.cos(np.radians(20))], 2).mean(axis=0)
    expected = np.tensordot(mean_k, cr.decode(folder / "curved.h5").coeffs_khwc, 1)
    soft = f"app.isSlow = {str(slow).lower()}; app.pace = 0; " + lamp(2, middle, softness=20)
    assert decibels(shown(page, soft), expected) > least
    assert decibels(shown(page, lamp(2, middle)), expected) < 50


def test_files_are_compared(page, folder):
    changes = lamp(0) + "; Object.assign(app.state, { compare: 'error', second: 1 }); app.changed()"
    second = shown(page, changes, slot=1)
    assert decibels(second, cr.relight(folder / "klt.h5", LAMP)) > 60
    page.wait("/dB from klt.h5/.test(document.getElementById('figure').textContent)")
    told = float(page.evaluate("document.getElementById('figure').textContent.match(/([\\d.]+) dB/)[1]"))
    first, second = (cr.relight(folder / name, LAMP) for name in ("fit.h5", "klt.h5"))
    from tests.reference.psnr import encode

    expected = decibels(encode(np.clip(first, 0, 1)), encode(np.clip(second, 0, 1)))
    assert told == pytest.approx(expected, abs=1.0)


def test_it_asks_for_nothing_and_nothing_goes_wrong(page, folder):
    asked = [address for address in page.requests() if not address.startswith(("blob:", "data:"))]
    assert asked == [(folder / "viewer.html").as_uri()]
    assert page.faults() == []
    assert page.evaluate("clrelight.app.store.faults") == []


def test_figures_are_of_a_frame_that_was_drawn(page):
    """A comparison that is asked for has no second picture before its first frame, which may be late."""
    before = page.faults()
    page.evaluate("app = clrelight.app; app.set('compare', 'one'); 0")
    page.wait("app.planned === null && app.renderer.pictures.length === 1 && app.isWhole && app.store.isIdle")
    page.evaluate("""(async () => {
        const soon = globalThis.requestAnimationFrame;
        globalThis.requestAnimationFrame = () => 1;
        app.planFigures();
        app.set('compare', 'split');
        await new Promise((done) => setTimeout(done, 1000));
        globalThis.requestAnimationFrame = soon;
        app.planned = null;
        app.set('compare', 'one');
    })()""")
    assert page.faults() == before


def test_keys_and_pointers(page):
    # The places below are on a canvas of 256 pixels, which other tests make, where they come first.
    page.evaluate(
        "clrelight.app.canvas.style.cssText = 'position: fixed; left: 0; top: 0; width: 256px; height: 256px';"
        "clrelight.app.ratio = 1; clrelight.app.resize()"
    )
    page.evaluate("app = clrelight.app; Object.assign(app.state, { light: 'lamp', compare: 'one' }); app.fit()")
    before = page.evaluate("app.state.lamp.direction")
    page.evaluate("app.canvas.focus()")
    for key in ("ArrowLeft", "ArrowUp"):
        page.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key)
    after = page.evaluate("app.state.lamp.direction")
    assert after[0] < before[0] - 0.03
    assert after[1] > before[1] + 0.03
    assert "degrees high" in page.evaluate("document.getElementById('spoken').textContent")
    mouse = {"button": "left", "clickCount": 1, "buttons": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=40, y=128, **mouse)
    assert page.evaluate("[app.dragging, app.state.lamp.direction[0] < -0.6]") == [True, True]
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=220, y=128, **mouse)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=220, y=128, **mouse)
    # Moves come with the next frame, which is late where there is much to do.
    page.wait("app.state.lamp.direction[0] > 0.6")
    assert page.evaluate("app.dragging") is False
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=200, y=50, deltaX=0, deltaY=-320)
    page.wait("Math.abs(app.view.zoom - 2) < 0.01")
    assert page.evaluate("app.view.toImage(200, 50).map(Math.round)") == [200, 50]
    page.evaluate("app.fit()")


def test_two_fingers_zoom_and_pan(page):
    def touch(kind, *places):
        points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
        page.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    page.evaluate("app = clrelight.app; Object.assign(app.state, { light: 'lamp', compare: 'one' }); app.fit()")
    zoom, place = page.evaluate("[app.view.zoom, app.view.toImage(100, 100)]")  # as the tests before have left the page
    light = page.evaluate("app.state.lamp.direction")
    touch("touchStart", (100, 100))
    assert page.evaluate("app.state.lamp.direction") != light
    touch("touchStart", (100, 100), (140, 100))  # what the first has done is taken back
    touch("touchMove", (80, 100), (160, 100))
    touch("touchMove", (90, 120), (170, 120))
    touch("touchEnd")
    assert page.evaluate("app.view.zoom") == pytest.approx(2.0 * zoom, rel=0.02)
    assert page.evaluate("app.view.toImage(90, 120)") == pytest.approx(place, abs=1)
    assert page.evaluate("[app.state.lamp.direction, app.dragging]") == [light, False]
    page.evaluate("app.fit()")


def test_a_double_click_moves_no_light(page):
    page.evaluate("app = clrelight.app; Object.assign(app.state, { light: 'lamp', compare: 'one' }); app.zoom(2)")
    light = page.evaluate("app.state.lamp.direction")
    for count in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            page.call("Input.dispatchMouseEvent", type=kind, x=60, y=60, button="left", clickCount=count)
    assert page.evaluate("[app.view.fitted, app.state.lamp.direction]") == [True, light]


def test_the_keyboard_alone(page):
    """Where nothing has the focus, keys are the picture's; what has it is seen to have it, and keeps its own."""

    def press(key):
        for kind in ("keyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    page.evaluate("app = clrelight.app; Object.assign(app.state, { light: 'lamp', compare: 'one' }); app.fit()")
    page.evaluate("document.activeElement.blur()")
    height = "app.state.lamp.direction[1]"
    before = page.evaluate(height)
    press("ArrowUp")
    after = page.evaluate(height)
    assert after > before
    page.evaluate("document.getElementById('exposure').focus()")
    press("ArrowUp")
    assert page.evaluate(height) == after
    press("Tab")
    page.evaluate("app.canvas.focus()")
    press("ArrowDown")
    drawn = "(({ outlineStyle, outlineWidth }) => [outlineStyle, outlineWidth])(getComputedStyle(app.canvas))"
    assert page.evaluate(drawn) == ["solid", "3px"]
    assert page.evaluate(height) < after
    page.evaluate("app.set('exposure', 0)")


def test_what_changes_no_light_sums_no_planes(page):
    """Exposure, curves and the line between two files are drawn of pictures that are there."""
    settled = "app.planned === null && app.isWhole && app.store.isIdle"
    page.evaluate(
        "app = clrelight.app; Object.assign(app.state, { light: 'lamp', compare: 'split', second: 1 }); app.fit()"
    )
    page.wait(settled)
    sums = page.evaluate("app.renderer.sums")
    for change in ("'exposure', 0.5", "'curve', 'filmic'", "'split', 0.3", "'errorGain', 9", "'compare', 'error'"):
        page.evaluate(f"app.set({change})")
        page.wait(settled)
    assert page.evaluate("app.renderer.sums") == sums
    for change in ("['lamp', 'softness'], 9", "['lamp', 'softness'], 0", "'light', 'sky'", "'first', 1", "'first', 0"):
        before = page.evaluate("app.renderer.sums")
        page.evaluate(f"app.set({change})")
        page.wait(settled)
        assert page.evaluate("app.renderer.sums") > before, change
    page.evaluate(
        "app.set('exposure', 0); app.set('curve', 'srgb'); app.set('compare', 'one'); app.set('light', 'lamp')"
    )


def test_everything_has_a_name(page):
    """What a screen reader says: Chromium computes roles and names of all controls."""
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    controls = ("button", "slider", "combobox", "radio", "checkbox", "image", "DisclosureTriangle")
    nameless = [
        node["role"]["value"]
        for node in nodes
        if not node["ignored"] and node["role"]["value"] in controls and not node.get("name", {}).get("value")
    ]
    assert nameless == []
    assert sum(node["role"]["value"] in controls for node in nodes if not node["ignored"]) > 12
    # Who says what is written on a button means that button.
    unlike = """[...document.querySelectorAll("button[aria-label]")].map((each) => [each.ariaLabel, each.textContent])
      .filter(([name, text]) => /\\w/.test(text) && !name.includes(text))"""
    assert page.evaluate(unlike) == []


def test_a_page_that_is_served_shows_photographs(folder):
    side = 48
    succeed("synth", "ring", folder / "ring.h5", "--size", side, "--lights", 20)
    succeed("fit", folder / "ring.h5", folder / "ring_fit.h5", "--degree", 2)
    with (
        served_viewer([folder / "ring_fit.h5"], reference=folder / "ring.h5") as server,
        cr.open_stack(folder / "ring.h5") as stack,
    ):
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            with opened_browser(server.address, width=700, height=700) as page:
                page.wait("globalThis.clrelight?.app", 60)
                changes = lamp(0, stack.directions_i3[7] + 0.01) + "; app.set('compare', 'split')"
                photograph = shown(page, changes, slot=1, side=side)
                np.testing.assert_allclose(photograph, stack.images_ihwc[7:8][0] / stack.peak, atol=1e-3)
                fitted = shown(page, "app.set('compare', 'split')", slot=0, side=side)
                expected = cr.relight(folder / "ring_fit.h5", stack.directions_i3[7])
                assert decibels(fitted, expected) > 60
                asked = [a for a in page.requests() if not a.startswith(("blob:", "data:", server.address))]
                assert asked == []
        finally:
            server.shutdown()
            thread.join()


PHONE = """(() => {
  const box = (each) => each.getBoundingClientRect();
  const seen = [...document.querySelectorAll("body *")].filter((each) => each.offsetParent && each.checkVisibility());
  const outside = seen.filter((each) => box(each).left < -1 || box(each).right > innerWidth + 1).map((each) => each.id);
  const touched = seen.filter((each) => each.matches("button, select, summary, input[type=range], .choice label"));
  const low = touched.filter((each) => box(each).height < 30).map((each) => each.id || each.textContent);
  return [document.documentElement.scrollWidth, outside, low, touched.length > 12];
})()"""


def test_a_phone_has_room_for_all_controls(page):
    def metrics(width, height, mobile):
        size = {"width": width, "height": height}
        page.call("Emulation.setDeviceMetricsOverride", **size, deviceScaleFactor=1, mobile=mobile)

    metrics(390, 844, True)
    try:
        for light in ("lamp", "sky", "environment"):
            page.evaluate(f"document.getElementById('light-{light}').click()")
            assert page.evaluate(PHONE) == [390, [], [], True]
        page.evaluate("document.getElementById('compare-split').click()")
        assert page.evaluate(PHONE) == [390, [], [], True]
        page.evaluate("document.getElementById('help-open').click()")
        width = "document.querySelector('#keys > {}').getBoundingClientRect().width"
        name, meaning = (page.evaluate(width.format(each)) for each in ("dt", "dd"))
        assert meaning > name > 60
        assert page.evaluate("document.getElementById('help').getBoundingClientRect().height") < 500
    finally:
        page.evaluate("document.getElementById('help').close(); document.getElementById('compare-one').click()")
        metrics(700, 700, False)


def test_an_exposure_that_is_asked_for_early_comes_with_the_picture(page):
    page.evaluate(
        "app = clrelight.app; Object.assign(app.state, { light: 'lamp', exposure: 5 }); app.isWhole = false;"
        "app.renderer.pictures = []; app.exposeAutomatically()"
    )
    page.wait("app.isWhole && app.state.exposure < 4")
    assert page.faults() == []
    page.evaluate("app.set('exposure', 0)")
