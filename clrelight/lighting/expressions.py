"""Functions of a direction as people write them: ``max(0, z)``, ``theta < 30 * deg``."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted

VARIABLES = ("x", "y", "z", "theta", "phi")
"""Of a unit vector: its parts, the angle from z, and the azimuth from x to y in -pi .. pi; angles in radians."""

_CONSTANTS = {"pi": math.pi, "e": math.e, "deg": math.pi / 180.0}
_FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "abs": (np.abs, 1),
    "sqrt": (np.sqrt, 1),
    "exp": (np.exp, 1),
    "log": (np.log, 1),
    "sin": (np.sin, 1),
    "cos": (np.cos, 1),
    "tan": (np.tan, 1),
    "asin": (np.arcsin, 1),
    "acos": (np.arccos, 1),
    "atan": (np.arctan, 1),
    "atan2": (np.arctan2, 2),
    "floor": (np.floor, 1),
    "sign": (np.sign, 1),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "where": (np.where, 3),
}
"""Functions, and how many arguments they take; min and max take more."""
_BINARY: dict[type, Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
}
_COMPARE: dict[type, Callable[..., Any]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
}
_MOST_CHARACTERS, _MOST_NODES = 1000, 300


@dataclass(frozen=True)
class Expression:
    """A function of directions, checked when made; `parse_expression` makes it.

    Attributes
    ----------
    text : str
    parts : tuple
        One syntax tree for each channel.
    """

    text: str
    parts: tuple[ast.expr, ...]

    @property
    def channels(self) -> int:
        """1 or 3."""
        return len(self.parts)

    def __call__(self, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values (n, channel) at unit vectors (n, 3); InputError where one is not finite."""
        x, y, z = np.asarray(directions_i3, np.float64).T
        names = {"x": x, "y": y, "z": z, "theta": np.arccos(np.clip(z, -1.0, 1.0)), "phi": np.arctan2(y, x)}
        values_ic = np.empty((len(x), len(self.parts)))
        with np.errstate(all="ignore"):  # what is not finite is told below
            for channel, part in enumerate(self.parts):
                values_ic[:, channel] = _evaluate(part, {**_CONSTANTS, **names})
        bad = np.argwhere(~np.isfinite(values_ic))
        if len(bad):
            i, c = (int(v) for v in bad[0])
            at = ", ".join(f"{v:.3g}" for v in directions_i3[i])
            raise InputError(f"the expression {self.text!r} is {values_ic[i, c]} at direction {at}")
        return values_ic


def parse_expression(text: str) -> Expression:
    """Return the function that a text says: arithmetic, comparisons (1 or 0) and functions of `VARIABLES`.

    Three expressions separated by ``;`` are red, green and blue. Nothing else is taken: no names but those of
    variables, constants (pi, e, deg) and functions, no attributes, no subscripts, no strings, no other calls.

    Raises
    ------
    InputError
        Naming what was found that is none of these.
    """
    if len(text) > _MOST_CHARACTERS:
        raise InputError(f"an expression has at most {_MOST_CHARACTERS} characters, got {len(text)}")
    words = text.split(";")
    if len(words) not in (1, 3):
        raise InputError(f"an expression is one, or three separated by ';' for red, green and blue, got {len(words)}")
    parts = []
    for word in words:
        try:
            tree = ast.parse(word.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise InputError(f"{word.strip()!r} is no expression such as max(0, z) or theta < 30 * deg") from None
        if sum(1 for _ in ast.walk(tree)) > _MOST_NODES:
            raise InputError(f"an expression has at most {_MOST_NODES} parts")
        _check(tree.body)
        parts.append(tree.body)
    return Expression(text, tuple(parts))


def _check(node: ast.expr) -> None:
    """Raise InputError where a tree holds anything but numbers, known names, arithmetic and known functions."""
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool) or not isinstance(node.value, int | float) or not abs(node.value) < 1e300:
            raise InputError(f"an expression holds numbers, got {node.value!r}")
    elif isinstance(node, ast.Name):
        if node.id not in VARIABLES and node.id not in _CONSTANTS:
            known = ", ".join([*VARIABLES, *_CONSTANTS])
            raise InputError(f"{node.id!r} is unknown: variables and constants are {known}")
    elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        _check(node.left)
        _check(node.right)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        _check(node.operand)
    elif isinstance(node, ast.Compare) and all(type(op) in _COMPARE for op in node.ops):
        for each in (node.left, *node.comparators):
            _check(each)
    elif isinstance(node, ast.Call):
        _check_call(node)
    else:
        raise InputError(
            f"an expression has numbers, + - * / % **, < <= > >=, and functions, no {type(node).__name__.lower()}"
        )


def _check_call(node: ast.Call) -> None:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name not in _FUNCTIONS or node.keywords:
        raise InputError(f"functions are {', '.join(_FUNCTIONS)}, got {name or 'something else'!r}")
    count = _FUNCTIONS[name][1]
    if len(node.args) != count and not (name in ("min", "max") and len(node.args) > count):
        raise InputError(f"{name} takes {counted(count, 'argument')}, got {len(node.args)}")
    for each in node.args:
        _check(each)


def _evaluate(node: ast.expr, names: dict[str, Any]) -> Any:
    """Return the value of a checked tree; numbers are floats, so that no power grows without bound."""
    if isinstance(node, ast.Constant):
        return np.float64(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        return names[node.id]
    if isinstance(node, ast.BinOp):
        return _BINARY[type(node.op)](_evaluate(node.left, names), _evaluate(node.right, names))
    if isinstance(node, ast.UnaryOp):
        value = _evaluate(node.operand, names)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.Compare):
        values = [_evaluate(each, names) for each in (node.left, *node.comparators)]
        held = [_COMPARE[type(op)](a, b) for op, a, b in zip(node.ops, values, values[1:], strict=False)]
        return np.logical_and.reduce(held).astype(np.float64) if len(held) > 1 else np.asarray(held[0], np.float64)
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        raise InputError("an expression is checked before it is evaluated")
    function = _FUNCTIONS[node.func.id][0]
    arguments = [_evaluate(each, names) for each in node.args]
    if node.func.id == "where":
        return np.where(np.asarray(arguments[0]) != 0, arguments[1], arguments[2])
    if node.func.id in ("min", "max"):
        total = arguments[0]
        for each in arguments[1:]:
            total = function(total, each)
        return total
    return function(*arguments)
