"""Numbers that are written as expressions."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import InputError
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT

CONSTANTS = {"pi": math.pi, "twopi": 2 * math.pi, "c_light": SPEED_OF_LIGHT, "e_charge": ELEMENTARY_CHARGE}
FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")
} | {"abs": abs}
OPERATORS: dict[type[ast.AST], Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def number(written: Any, where: str, names: Mapping[str, float]) -> float:
    """Return a number, or what an expression of numbers, functions and names comes to. InputError, with `where` it stands."""
    if isinstance(written, bool) or not isinstance(written, int | float | str):
        raise InputError(f"{where} is {written!r:.60}; give a number")
    try:
        value = float(written) if not isinstance(written, str) else _value(_parsed(written), {**CONSTANTS, **names})
    except (SyntaxError, ArithmeticError, ValueError, TypeError, KeyError, RecursionError) as refused:
        what = f"{refused.args[0]!r} is unknown" if isinstance(refused, KeyError) else "no expression of numbers"
        raise InputError(f"{where} is {written!r:.60}: {what}; give a number") from None
    if not math.isfinite(value):
        raise InputError(f"{where} is {written!r:.60}; give a finite number")
    return value


def _parsed(written: str) -> ast.AST:
    return ast.parse(written.replace("^", "**").strip(), mode="eval").body


def _value(node: ast.AST, names: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
        case ast.Name(id=name):
            return names[name]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            return OPERATORS[type(op)](_value(left, names), _value(right, names))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            return OPERATORS[type(op)](_value(operand, names))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](*(_value(one, names) for one in arguments))
    raise ValueError
