"""Formulas in x, y and z, or in t, as scene files hold them."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..arithmetic import OPERATORS, parsed, value
from .complaints import complaint

FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(np, name)
    for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "sinh", "cosh", "tanh", "arctan2", "hypot")
} | {"abs": np.abs, "min": np.minimum, "max": np.maximum}
CONSTANTS = {"pi": np.pi}
COORDINATES = ("x", "y", "z")
Value = np.ndarray | float


def formula(text: str, variables: Sequence[str] = COORDINATES) -> Callable[..., Value]:
    """Return the function of x, y and z (arrays, m), or of other `variables`, that a formula such as "1e6*(x^2 - y^2)" means.

    Nothing but arithmetic, `pi` and the functions of `FUNCTIONS` is understood; anything else is a complaint.
    """
    try:
        tree = parsed(text)
    except (SyntaxError, ValueError):
        raise complaint("is no formula", 'write one such as "1e6*(x^2 - y^2)"', found=text) from None
    _check(tree, text, variables)
    return lambda *values: value(tree, {**CONSTANTS, **dict(zip(variables, values, strict=True))}, FUNCTIONS)


def _check(node: ast.expr, text: str, variables: Sequence[str]) -> None:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return
        case ast.Name(id=name) if name in CONSTANTS or name in variables:
            return
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            parts = [left, right]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            parts = [operand]
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]) if name in FUNCTIONS:
            expected = 2 if name in ("min", "max", "arctan2", "hypot") else 1
            if len(parts) != expected:
                raise complaint(
                    f"gives {name} {len(parts)} values", f"{name} takes {expected}; correct the formula", found=text
                )
        case _:
            names = ", ".join([*variables, *CONSTANTS, *FUNCTIONS])
            raise complaint(
                f'holds "{ast.unparse(node)}", which no formula knows',
                f"use numbers, + - * / ^ and {names}",
                found=text,
            )
    for part in parts:
        _check(part, text, variables)
