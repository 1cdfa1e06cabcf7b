"""GLSL for users: irradiance of matte surfaces, and radiance transfer per vertex and from textures.

The texts are GLSL ES 3.00 functions to be pasted into a shader: no version line, no names but their own. Constants are
written with 17 digits, which is all that float64 has; a GPU rounds them to float32.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.hemisphere import project_onto_hemisphere
from clrelight.harmonics.index import coefficient_count
from clrelight.lighting.irradiance import irradiance_matrix
from clrelight.lighting.light import Light

FORMS = ("attributes", "texture")
"""Where transfer vectors come from: attributes of vertices, or the layers of an array texture."""

MAX_ATTRIBUTES = 15
"""Vectors of four numbers that every GPU has for a vertex: 16, one of which is the position."""

_HEAD = "// {what}, by clrelight, for the light of {source}.\n"


def irradiance_shader(light: Light) -> str:
    """Return GLSL of the irradiance of a matte surface with unit normal n (irradiance-environment-maps, eq. 11 and 13).

    ``irradiance_matrix(n)`` is ``(n, 1) M (n, 1)`` of each channel, ``irradiance_polynomial(n)`` the same written out.
    Divided by pi and times the albedo it is the radiance that is reflected. A light of one channel is gray.
    """
    matrices_c44 = irradiance_matrix(light)
    channels = [matrices_c44[min(c, light.channels - 1)] for c in range(3)]
    lines = [_HEAD.format(what="Irradiance E(n) of unit normals", source=_said(light))]
    lines.append("// Equation 11 of Ramamoorthi and Hanrahan 2001: one matrix a channel.\n")
    for name, matrix_44 in zip("RGB", channels, strict=True):
        columns = ",\n    ".join(", ".join(_number(v) for v in column) for column in matrix_44.T)
        lines.append(f"const mat4 IRRADIANCE_{name} = mat4(\n    {columns}\n);\n")
    products = ", ".join(f"dot(v, IRRADIANCE_{name} * v)" for name in "RGB")
    lines.append(f"\nvec3 irradiance_matrix(vec3 n) {{\n    vec4 v = vec4(n, 1.0);\n    return vec3({products});\n}}\n")
    lines.append("\n// Equation 13: the polynomial written out, factors 2 and constants c1 .. c5 multiplied in.\n")
    lines.append("vec3 irradiance_polynomial(vec3 n) {\n    float x = n.x;\n    float y = n.y;\n    float z = n.z;\n")
    terms = _polynomial(np.stack(channels))
    text = "\n        + ".join(f"{_vector(values)} * ({product})" for product, values in terms)
    lines.append(f"    return {text};\n}}\n")
    return "".join(lines)


def _polynomial(matrices_c44: NDArray[np.float64]) -> list[tuple[str, NDArray[np.float64]]]:
    """Return products of x, y, z and the factor of each channel."""
    m = matrices_c44
    return [
        ("x * x - y * y", m[:, 0, 0]),
        ("z * z", m[:, 2, 2]),
        ("1.0", m[:, 3, 3]),
        ("x * y", 2.0 * m[:, 0, 1]),
        ("x * z", 2.0 * m[:, 0, 2]),
        ("y * z", 2.0 * m[:, 1, 2]),
        ("x", 2.0 * m[:, 0, 3]),
        ("y", 2.0 * m[:, 1, 3]),
        ("z", 2.0 * m[:, 2, 3]),
    ]


def transfer_shader(
    light: Light, degree: int, *, channels: int = 1, form: str = "attributes", hemispherical: bool = False
) -> str:
    """Return GLSL of the radiance that a vertex or texel reflects, ``sum_k T_k L_k``, k = 0 .. (degree + 1)**2 - 1.

    Parameters
    ----------
    light : Light
        In the axes of the transfer vectors; what it lacks is 0.
    degree : int
        Of the transfer vectors.
    channels : int
        1: one vector for red, green and blue. 3: one each; attributes then hold vec3 of each coefficient.
    form : str
        One of `FORMS`. ``"attributes"``: ``transfer_radiance(float or vec3 t[N])`` and, where they fit into
        `MAX_ATTRIBUTES`, attributes that hold four coefficients each and ``transfer_from_attributes()``. ``"texture"``:
        ``transfer_from_texture(sampler2DArray, vec2 uv)``, four coefficients a layer (of 3 channels: one a layer).
    hemispherical : bool
        The vectors are fits of the upper hemisphere: the light is multiplied by the autocorrelation of the basis
        (noise-resistant-fitting, eq. 4), and must lie in the vertex's frame.
    """
    if form not in FORMS:
        raise InputError(f"a transfer shader is one of {', '.join(FORMS)}, got {form!r}")
    if channels not in (1, 3):
        raise InputError(f"transfer vectors have 1 or 3 channels, got {channels}")
    n_coeff = coefficient_count(degree)
    seen_kc = _seen(light, degree, hemispherical)
    constants = ",\n    ".join(_vector(row) for row in seen_kc)
    lines = [_HEAD.format(what=f"Radiance of transfer vectors of degree {degree}", source=_said(light))]
    if hemispherical:
        lines.append("// Fits of the upper hemisphere: the basis's autocorrelation is multiplied in.\n")
    lines.append(
        f"const int N_COEFF = {n_coeff};\nconst vec3 LIGHT[{n_coeff}] = vec3[{n_coeff}](\n    {constants}\n);\n"
    )
    if form == "texture":
        return "".join([*lines, _texture(n_coeff, channels)])
    kind = "float" if channels == 1 else "vec3"
    total = "\n        + ".join(f"LIGHT[{k}] * t[{k}]" for k in range(n_coeff))
    lines.append(f"\nvec3 transfer_radiance({kind} t[{n_coeff}]) {{\n    return {total};\n}}\n")
    return "".join([*lines, _attributes(n_coeff, channels)])


def _attributes(n_coeff: int, channels: int) -> str:
    """Return attributes and what sums them, a remark where there are too many."""
    count = -(-n_coeff // 4) if channels == 1 else n_coeff
    if count > MAX_ATTRIBUTES:
        return (
            f"\n// {count} attributes: every GPU has {MAX_ATTRIBUTES} beside the position. Use the form texture, or "
            "a buffer.\n"
        )
    kind = "vec4" if channels == 1 else "vec3"
    lines = [f"\nin {kind} transfer_{j};\n" if j == 0 else f"in {kind} transfer_{j};\n" for j in range(count)]
    if channels == 3:
        total = "\n        + ".join(f"LIGHT[{k}] * transfer_{k}" for k in range(n_coeff))
    else:
        total = "\n        + ".join(f"LIGHT[{k}] * transfer_{k // 4}.{'xyzw'[k % 4]}" for k in range(n_coeff))
    return "".join([*lines, f"\nvec3 transfer_from_attributes() {{\n    return {total};\n}}\n"])


def _texture(n_coeff: int, channels: int) -> str:
    layers = -(-n_coeff // 4) if channels == 1 else n_coeff
    lines = ["\nvec3 transfer_from_texture(sampler2DArray layers, vec2 uv) {\n"]
    lines += [f"    vec4 t{j} = texture(layers, vec3(uv, {j}.0));\n" for j in range(layers)]
    if channels == 3:
        total = "\n        + ".join(f"LIGHT[{k}] * t{k}.xyz" for k in range(n_coeff))
    else:
        total = "\n        + ".join(f"LIGHT[{k}] * t{k // 4}.{'xyzw'[k % 4]}" for k in range(n_coeff))
    return "".join([*lines, f"    return {total};\n}}\n"])


def _seen(light: Light, degree: int, hemispherical: bool) -> NDArray[np.float64]:
    """Return the light's coefficients as transfer vectors meet them, (n_coeff, 3)."""
    seen_kc = np.zeros((coefficient_count(degree), light.channels))
    held_kc = project_onto_hemisphere(light.coeffs_kc, degree) if hemispherical else light.coeffs_kc[: len(seen_kc)]
    seen_kc[: len(held_kc)] = held_kc
    return np.broadcast_to(seen_kc, (len(seen_kc), 3))


def _number(value: float) -> str:
    text = f"{value:.17g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _vector(values: NDArray[np.float64]) -> str:
    return f"vec3({', '.join(_number(v) for v in values)})"


def _said(light: Light) -> str:
    """Return what the light was made of, in one line that no comment ends."""
    return " ".join("".join(c if c.isprintable() and c != "\\" else " " for c in light.source).split()) or "no name"
