"""What surfaces with glossy operators reflect: radiance over views under a light, and towards a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.dataset import CoefficientMap
from clrelight.directions import are_unit
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.rotation_batch import rotate_many
from clrelight.memory import PIECE_BYTES
from clrelight.surface import surface_facts
from clrelight.tiles import row_tiles

OPERATOR = "operator"
"""Of maps of operators, in place of a fit."""
METHOD = "reflected"
"""Of maps of radiance over views, in place of a fit."""


def reflect(operators: CoefficientMap, light_kc: NDArray[np.float64], views: ArrayLike) -> NDArray[np.float32]:
    """Return the radiance that each vertex sends towards the eye, (height, width, channel) of the map, not clipped.

    Parameters
    ----------
    operators : CoefficientMap
        Of `clrelight.transfer.operators.transfer_operators`, or what a codec made of one.
    light_kc : ndarray, shape (n_coeff, 1 or 3), float64
        Light in the axes of the positions, of any degree: what the operators do not take is left out.
    views : array_like, shape (3,) or (n_vertex, 3)
        Unit vectors from the surface to the eye, in the axes of the positions: one for all vertices, or one for each.
        Seen from behind a vertex is what its function over views says there.
    """
    surface = operators.surface
    if surface is None:
        raise InputError("these operators belong to no surface: views need its frames")
    views_v3 = np.asarray(views, np.float64)
    if views_v3.shape not in ((3,), (surface.n_vertex, 3)) or not are_unit(views_v3.reshape(-1, 3)):
        raise InputError(f"views must be a unit vector, or {surface.n_vertex} of them, got shape {views_v3.shape}")
    height, width = operators.image_shape[:2]
    over_views_khwc = reflected_coefficients(operators, light_kc)
    _, view_degree = operator_degrees(operators)
    if surface.tangents_v3 is None and views_v3.ndim == 1:
        basis_vk = evaluate_basis(views_v3[None], view_degree)
    else:
        local_v3 = np.einsum("vab,vb->va", surface.frames(), np.broadcast_to(views_v3, (surface.n_vertex, 3)))
        local_v3 /= np.linalg.norm(local_v3, axis=1, keepdims=True)
        basis_vk = evaluate_basis(local_v3, view_degree)
    basis_khw = np.broadcast_to(basis_vk.T, (basis_vk.shape[1], surface.n_vertex)).reshape(-1, height, width)
    return np.einsum("khw,khwc->hwc", basis_khw.astype(np.float32), over_views_khwc)


def reflect_map(operators: CoefficientMap, light_kc: NDArray[np.float64]) -> CoefficientMap:
    """Return the reflected radiance as a map over directions to the eye, under a light that is then fixed.

    Its surface says that functions are of the view; relighting it with a direction shows what is seen from there.
    """
    light_degree, view_degree = operator_degrees(operators)
    surface = None if operators.surface is None else replace(operators.surface, argument="view")
    return CoefficientMap(
        reflected_coefficients(operators, light_kc),
        view_degree,
        METHOD,
        operators.peak,
        operators.transfer,
        operators.directions_i3,
        config={**operators.config, "reflected_degree": light_degree},
        name=operators.name,
        surface=surface,
    )


def reflected_coefficients(operators: CoefficientMap, light_kc: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return coefficients over views, (n_out, height, width, channel) float32: each vertex's operator times the light.

    The operators may lie in a file: they are read some rows at a time.
    """
    light_degree, view_degree = operator_degrees(operators)
    n_in, n_out = coefficient_count(light_degree), coefficient_count(view_degree)
    light = np.asarray(light_kc, np.float64)
    if light.ndim != 2 or light.shape[1] not in (1, 3) or not np.isfinite(light).all():
        raise InputError(f"light must be finite numbers of shape (coefficient, 1 or 3), got shape {light.shape}")
    taken_ic = np.zeros((n_in, light.shape[1]))
    taken_ic[: len(light)] = light[:n_in]
    height, width, own = operators.image_shape
    if own not in (1, 3):
        raise InputError(f"light needs operators of 1 or 3 channels, these have {own}")
    frames_v33 = _light_frames(operators)
    made_khwc = np.empty((n_out, height, width, max(own, light.shape[1])), np.float32)
    step = max(1, PIECE_BYTES // (4 * n_in * n_out * width * own))
    for first, end in row_tiles((0, height), step):
        part_dhwc = operators.read_rows(first, end, np.empty((n_in * n_out, end - first, width, own), np.float32))
        part_oipc = part_dhwc.reshape(n_out, n_in, -1, own)
        if frames_v33 is None:
            light_pic = taken_ic[None]
        else:
            light_pic = rotate_many(taken_ic, frames_v33[first * width : end * width])
        light_ipc = np.asarray(light_pic, np.float32).transpose(1, 0, 2)
        for c in range(made_khwc.shape[3]):
            entries_oip, weights_ip = part_oipc[..., c % own], light_ipc[..., c % light.shape[1]]
            weights_ip = np.broadcast_to(weights_ip, entries_oip.shape[1:])
            made_khwc[:, first:end, :, c] = np.einsum("oip,ip->op", entries_oip, weights_ip).reshape(n_out, -1, width)
    return made_khwc


def _light_frames(operators: CoefficientMap) -> NDArray[np.float64] | None:
    """Return the frames that light is to be turned to, None where operators take it in the axes of the positions."""
    if operators.config.get("light_frame", "global") == "global":
        return None
    if operators.surface is None or operators.surface.tangents_v3 is None:
        raise InputError("these operators take light in frames of vertices, but have no surface with tangents: give it")
    return operators.surface.frames()


def add_diffuse(operators: CoefficientMap, transfer: CoefficientMap) -> CoefficientMap:
    """Return operators with diffuse transfer added: with bounces, say, under a specular part of direct light.

    What is diffuse is alike in all directions, so a transfer vector is the constant row of an operator.

    Parameters
    ----------
    operators : CoefficientMap
        Of `transfer_operators`.
    transfer : CoefficientMap, shape (n_coeff, the same height and width, channel)
        Transfer vectors in the axes of the positions, of the operators' light degree at least; one channel goes with
        three.
    """
    light_degree, _ = operator_degrees(operators)
    n_in = coefficient_count(light_degree)
    if transfer.degree < light_degree or transfer.image_shape[:2] != operators.image_shape[:2]:
        raise InputError(
            f"transfer of degree {transfer.degree} and {transfer.image_shape[:2]} does not go with operators for "
            f"light of degree {light_degree} and {operators.image_shape[:2]}"
        )
    if operators.config.get("light_frame", "global") != "global":
        raise InputError("these operators take light in frames of vertices, transfer vectors in the axes of the mesh")
    _check_same(operators, transfer)
    if 1 not in (few := {transfer.image_shape[2], operators.image_shape[2]}) and len(few) > 1:
        raise InputError(f"channels must be alike, or 1: got {sorted(few)}")
    added = np.asarray(transfer.coeffs_khwc[:n_in], np.float32) * np.float32(np.sqrt(4.0 * np.pi))
    whole = np.asarray(operators.coeffs_khwc, np.float32)
    channel = max(added.shape[3], whole.shape[3])
    total = np.array(np.broadcast_to(whole, (*whole.shape[:3], channel)))
    total[:n_in] += added
    return replace(operators, coeffs_khwc=total, config={**operators.config, "added": transfer.method})


def _check_same(operators: CoefficientMap, transfer: CoefficientMap) -> None:
    """Raise InputError where transfer is none, is in frames, or is known to be of other vertices."""
    facts = surface_facts(transfer.surface, transfer.config) or {}
    if transfer.method == OPERATOR or facts.get("argument", "light") != "light":
        raise InputError("what is added is diffuse transfer, as clrelight transfer makes it: functions of the light")
    if facts.get("frame", "global") != "global":
        raise InputError("transfer vectors in frames of vertices cannot be added: make them in the axes of the mesh")
    if transfer.surface is None or operators.surface is None:
        return
    own_v3, other_v3 = operators.surface.vertices_v3, transfer.surface.vertices_v3
    if own_v3.shape != other_v3.shape or not np.allclose(own_v3, other_v3, 0.0, 1e-6 * operators.surface.diagonal):
        raise InputError("the transfer is of other vertices, or in another order: give both the same --order and --up")


def operator_degrees(operators: CoefficientMap) -> tuple[int, int]:
    """Return the degrees of the light and of the views of a map of operators; InputError if it is none."""
    degrees = [operators.config.get(f"{which}_degree") for which in ("light", "view")]
    light, view = (each if isinstance(each, int) and not isinstance(each, bool) else -1 for each in degrees)
    if min(light, view) < 0 or coefficient_count(light) * coefficient_count(view) != operators.n_coeff:
        raise InputError("this map holds no operators: clrelight operators makes them")
    return light, view
