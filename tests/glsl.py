"""A translation of the GLSL that clrelight writes into Python, run in float32 as a GPU does."""

import re

import numpy as np


class Vector(np.ndarray):
    """A vector of float32 with GLSL's names of its components."""

    x = property(lambda self: self[0])
    y = property(lambda self: self[1])
    z = property(lambda self: self[2])
    w = property(lambda self: self[3])
    xyz = property(lambda self: self[:3])


def vector(*parts):
    return np.concatenate([np.atleast_1d(np.asarray(part, np.float32)) for part in parts]).view(Vector)


def matrix(*numbers):
    return np.asarray(numbers, np.float32).reshape(4, 4).T  # column by column


class Matrix:
    def __init__(self, values):
        self.values = values

    def __mul__(self, other):
        return (self.values @ other).astype(np.float32).view(Vector)


NAMES = {
    "vec3": vector,
    "vec4": vector,
    "mat4": lambda *numbers: Matrix(matrix(*numbers)),
    "dot": lambda a, b: np.float32(np.dot(a, b)),
    "array": lambda *rows: rows,
}
TYPE = r"(?:const )?(?:vec2|vec3|vec4|mat4|float|int|sampler2DArray)"


def translate(text):
    """Return Python of a GLSL text."""
    text = re.sub(r"//.*", "", text)
    text = re.sub(r"^in (?:vec3|vec4) \w+;$", "", text, flags=re.M)  # inputs are given by name
    text = re.sub(r"vec3\[\d+\]\(", "array(", text)
    lines, inside, statement = [], False, ""
    for line in text.splitlines():
        header = re.fullmatch(rf"{TYPE} (\w+)\((.*)\) {{", line)
        if header:
            given = [each.strip() for each in header[2].split(",") if each]
            names = [re.fullmatch(rf"{TYPE} (\w+)(?:\[\d+\])?", each)[1] for each in given]
            lines.append(f"def {header[1]}({', '.join(names)}):")
            inside = True
        elif line == "}":
            inside = False
        else:
            statement += " " + line.strip()
            if statement.endswith(";"):
                plain = re.sub(rf"^{TYPE} (\w+)(?:\[\d+\])? = ", r"\1 = ", statement.strip()[:-1])
                lines.append(("    " if inside else "") + plain)
                statement = ""
    assert not statement.strip()
    return "\n".join(lines)


def run(text, **inputs):
    """Return the functions of a GLSL text, with inputs by name."""
    space = {**NAMES, **inputs}
    exec(translate(text), space)
    return space
