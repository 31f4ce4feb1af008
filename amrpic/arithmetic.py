"""Arithmetic in words: expressions of numbers, names and functions, as scenes and lattices hold them."""

from __future__ import annotations

import ast
import functools
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from .errors import InputError
from .units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT

CONSTANTS = {"pi": math.pi, "twopi": 2 * math.pi, "c_light": SPEED_OF_LIGHT, "e_charge": ELEMENTARY_CHARGE}
FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")
} | {"abs": abs}
OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
COMPARISONS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
LOGIC: dict[type[ast.AST], Callable[..., Any]] = {
    ast.And: operator.and_,
    ast.Or: operator.or_,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
}


def is_number(word: str | bytes) -> bool:
    """Whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def number(written: Any, where: str, names: Mapping[str, float]) -> float:
    """Return a number, or what an expression of numbers, functions and names comes to. InputError, with `where` it stands."""
    if isinstance(written, bool) or not isinstance(written, int | float | str):
        raise InputError(f"{where} is {written!r:.60}; give a number")
    try:
        result = written if not isinstance(written, str) else value(parsed(written), {**CONSTANTS, **names}, FUNCTIONS)
        if isinstance(result, bool):
            raise ValueError(written)
        result = float(result)
    except (SyntaxError, ArithmeticError, ValueError, TypeError, KeyError, RecursionError) as refused:
        problem = f"{refused.args[0]!r} is unknown" if isinstance(refused, KeyError) else "no expression of numbers"
        raise InputError(f"{where} is {written!r:.60}: {problem}; give a number") from None
    if not math.isfinite(result):
        raise InputError(f"{where} is {written!r:.60}; give a finite number")
    return result


def parsed(written: str) -> ast.expr:
    """Return the tree of an expression, in which ^ and ** are powers. SyntaxError or ValueError for what is none."""
    return ast.parse(written.replace("^", "**").strip(), mode="eval").body


def value(node: ast.expr, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """Return what a tree comes to; names may be numbers or arrays, comparisons are true or false. KeyError for an unknown name,
    ValueError for what is no arithmetic."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id=name):
            return names[name]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            return OPERATORS[type(op)](value(left, names, functions), value(right, names, functions))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in LOGIC:
            return LOGIC[type(op)](value(left, names, functions), value(right, names, functions))
        case ast.BoolOp(op=op, values=parts):
            return functools.reduce(LOGIC[type(op)], (value(part, names, functions) for part in parts))
        case ast.Compare(left=left, ops=ops, comparators=comparators) if all(type(op) in COMPARISONS for op in ops):
            sides = [value(part, names, functions) for part in (left, *comparators)]
            pairs = zip(ops, sides, sides[1:], strict=False)
            return functools.reduce(operator.and_, (COMPARISONS[type(op)](lower, upper) for op, lower, upper in pairs))
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            return OPERATORS[type(op)](value(operand, names, functions))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in functions:
            return functions[name](*(value(part, names, functions) for part in arguments))
    raise ValueError(ast.unparse(node))
