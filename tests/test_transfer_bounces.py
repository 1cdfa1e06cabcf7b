"""Light that goes on between parts of a surface: its energy, its sum, both ways of sending it on, and its memory."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight.transfer import bounces as bounces_module
from clrelight.transfer.bounces import Operator, Spread, interreflected
from clrelight.transfer.gathering import Gatherer, Tally, points_of
from clrelight.transfer.meshes import vertex_areas
from clrelight.transfer.notes import behind_note, probe
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import make_samples
from clrelight.transfer.transport import transfer_vertices
from tests.meshes import icosphere, joined, open_box, quad

CONSTANT = np.sqrt(4.0 * np.pi)


def spread_of(surface, albedo, degree=1, samples=1024, memory=1 << 28):
    scene = RayScene(surface)
    gatherer = Gatherer(points_of(surface, scene), make_samples(samples), degree, scene, 1 << 26, Tally())
    operator = Operator(gatherer, memory)
    operator.direct()
    albedo_vc = np.full((surface.n_vertex, 1), albedo, np.float32)
    return Spread(operator, albedo_vc, vertex_areas(surface))


@pytest.mark.parametrize("scene", [open_box(6), icosphere(3)], ids=["box", "sphere"])
def test_a_white_open_surface_in_a_white_world_is_white(scene):
    tally = Tally()
    found = transfer_vertices(scene, 2, "interreflected", 1024, bounces=60, tally=tally)
    np.testing.assert_allclose(found[0] * CONSTANT, 1.0, atol=1e-2)
    assert tally.behind < 1e-3 * tally.rays


def test_bounces_within_a_closed_sphere_are_a_geometric_series():
    cave = icosphere(3, inside=True)
    start = np.random.default_rng(1).random((1, 1, 4)).astype(np.float32) * np.ones((cave.n_vertex, 1, 1), np.float32)
    for albedo in (0.3, 0.7):
        spread = spread_of(cave, albedo)
        found, energy = spread.gather(start, 200, 1e-4)
        np.testing.assert_allclose(found, start / (1 - albedo), rtol=1e-2)
        np.testing.assert_allclose(np.array(energy[1:]) / energy[:-1], albedo, rtol=1e-2)
        shot, left = spread.shoot(start, 1e-3)
        np.testing.assert_allclose(shot, start / (1 - albedo), rtol=1e-2)
        assert left[-1] <= 1e-3 * left[0]
        assert (np.diff(left) < 0).all()


def test_nothing_is_seen_from_within_a_closed_surface():
    found = transfer_vertices(icosphere(2, inside=True), 3, "shadowed", 256)
    np.testing.assert_allclose(found, 0.0, atol=1e-7)


def test_energy_falls_every_bounce():
    for scene in (open_box(6), joined(quad((-2, -2, 0), (4, 0, 0), (0, 4, 0), 8, 8), icosphere(2, 0.7, (0, 0, 1)))):
        tally = Tally()
        transfer_vertices(scene, 2, "interreflected", 256, bounces=8, tally=tally)
        assert len(tally.energy) == 9
        assert (np.diff(tally.energy) < 0).all()


def test_bounces_add_up():
    box = open_box(5)
    none = transfer_vertices(box, 2, "interreflected", 256, bounces=0)
    np.testing.assert_allclose(none, transfer_vertices(box, 2, "shadowed", 256), atol=1e-6)
    one, two = (transfer_vertices(box, 2, "interreflected", 256, bounces=n) for n in (1, 2))
    assert ((one - none)[0] > 0).all()
    assert (two - one)[0].sum() < 0.9 * (one - none)[0].sum()
    ends = Tally()
    found = transfer_vertices(box, 2, "interreflected", 256, bounces=500, threshold=1e-3, tally=ends)
    assert ends.energy[-1] <= 1e-3 * ends.energy[0] < ends.energy[-2]
    more = transfer_vertices(box, 2, "interreflected", 256, bounces=500, threshold=1e-6)
    assert 0 < np.abs(more - found).max() < 5e-3


def test_gathering_and_shooting_agree():
    box = replace(open_box(6), albedo_vc=np.full((245, 1), 0.8, np.float32))
    gathered, shot = (
        transfer_vertices(box, 2, "interreflected", 1024, bounces=500, way=way, threshold=1e-3)
        for way in ("gather", "shoot")
    )
    np.testing.assert_allclose(shot[0], gathered[0], rtol=1e-2)
    assert np.abs(shot - gathered).max() < 1e-2 * gathered[0].max()


def test_coloured_albedo_multiplies_every_bounce():
    """A red floor tinges white walls; channels do not mix."""
    box = open_box(5)
    on_floor = np.abs(box.normals_v3[:, 2]) > 0.5
    colour = np.where(on_floor[:, None], np.float32([0.9, 0.1, 0.1]), np.float32([1, 1, 1]))
    found = transfer_vertices(replace(box, albedo_vc=colour), 2, "interreflected", 256, bounces=20)
    for channel in range(3):
        gray = replace(box, albedo_vc=colour[:, channel : channel + 1])
        alone = transfer_vertices(gray, 2, "interreflected", 256, bounces=20)
        np.testing.assert_allclose(found[:, :, channel], alone[:, :, 0], atol=2e-6)
    walls = found[0, ~on_floor]
    assert (walls[:, 0] > walls[:, 1]).all()
    dark = replace(box, albedo_vc=np.zeros((box.n_vertex, 1), np.float32))
    np.testing.assert_array_equal(transfer_vertices(dark, 2, "interreflected", 256), 0.0)


@pytest.mark.parametrize("way", ["gather", "shoot"])
def test_hits_that_do_not_fit_are_traced_again(way, monkeypatch):
    box, kept = open_box(5), []
    whole, many = Tally(), Tally()
    asked = {"kind": "interreflected", "bounces": 3, "way": way, "threshold": 1e-2 if way == "shoot" else 0.0}
    expected = transfer_vertices(box, 2, samples_s3=256, tally=whole, **asked)

    class Watched(Operator):
        def direct(self, tell=None):
            found = super().direct(tell)
            kept.append(self.kept)
            return found

    monkeypatch.setattr(bounces_module, "Operator", Watched)
    found = transfer_vertices(box, 2, samples_s3=256, memory=1 << 17, tally=many, **asked)
    assert 0 < kept[0] < 1
    assert many.rays > 1.2 * whole.rays
    np.testing.assert_allclose(found, expected, atol=5e-6)


def test_back_faces_send_on_nothing_and_are_told_of():
    """Below an open lid that is seen from behind, its light is missing."""
    floor = quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), 4, 4)
    lids = {up: quad((-5, -5, 0.5), (10, 0, 0), (0, 10, 0)) for up in (True, False)}
    lids[False] = replace(lids[True], faces_f3=lids[True].faces_f3[:, ::-1], normals_v3=-lids[True].normals_v3)
    for up, lid in lids.items():
        scene = joined(floor, lid)
        tally = Tally()
        found = transfer_vertices(scene, 0, "interreflected", 1024, bounces=1, tally=tally)
        direct = transfer_vertices(scene, 0, "shadowed", 1024)
        middle = slice(0, floor.n_vertex)
        assert (tally.behind > 0.1 * tally.rays) == up
        assert bool(behind_note(tally)) == up
        assert ("%" in behind_note(probe(scene, RayScene(scene), make_samples(256)))[0]) if up else True
        gained = (found - direct)[0, middle, 0]
        assert (gained == 0).all() if up else (gained > 0).all()


def test_interreflected_returns_white_energy():
    tally = Tally()
    sphere = icosphere(2)
    interreflected(sphere, 1, make_samples(256), RayScene(sphere), tally=tally)
    np.testing.assert_allclose(tally.energy[0], 1.0, rtol=1e-6)
    assert tally.hits < 1e-4 * tally.rays
