"""Mutants: modules of the package with one small change."""

import ast
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.support.places import ROOT

_OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,), ast.Or: (ast.And,),
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Add,), ast.Div: (ast.Mult,), ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,), ast.BitXor: (ast.BitOr,),
    ast.LShift: (ast.RShift,), ast.RShift: (ast.LShift,), ast.Pow: (ast.Mult,),
}  # fmt: skip

_NAMES = dict(
    pair
    for one, other in (("min", "max"), ("any", "all"), ("argmin", "argmax"), ("minimum", "maximum"), ("floor", "ceil"),
                       ("logical_and", "logical_or"), ("zeros", "ones"), ("zeros_like", "ones_like"))
    for pair in ((one, other), (other, one))
)  # fmt: skip

#: Functions of two arguments that may be exchanged.
_SYMMETRIC = {"min", "max", "minimum", "maximum", "logical_and", "logical_or", "hypot", "gcd"}


class Mutant(NamedTuple):
    """A module with one change: its path, the line before and after, and its whole text."""

    path: str
    before: str
    after: str
    text: str

    @property
    def key(self) -> tuple[str, str, str]:
        return self.path, self.before, self.after


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """What may replace an expression."""
    fields = dict(ast.iter_fields(node))

    def other(**changed: object) -> ast.AST:
        return type(node)(**{**fields, **changed})

    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield from (other(ops=[operator()]) for operator in _OPERATORS[type(node.ops[0])])
    elif isinstance(node, ast.BinOp | ast.BoolOp):
        yield from (other(op=operator()) for operator in _OPERATORS.get(type(node.op), ()))
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield other(value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield other(value=node.value + 1)
    elif isinstance(node, ast.Attribute) and node.attr in _NAMES:
        yield other(attr=_NAMES[node.attr])
    elif isinstance(node, ast.Call) and len(node.args) > 1 and ast.unparse(node.func).split(".")[-1] not in _SYMMETRIC:
        args = [*node.args[:-2], node.args[-1], node.args[-2]]
        yield other(args=args)


def expressions(node: ast.AST, inside: bool = False) -> Iterator[ast.expr]:
    """Expressions that run: no annotations, decorators, texts or messages, and outside of functions no unions."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return
    if isinstance(node, ast.expr) and (inside or not isinstance(node, ast.BinOp)):
        yield node
    inside = inside or isinstance(node, ast.FunctionDef | ast.Lambda)
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list", "bases"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from expressions(child, inside)


def mutants(path: Path) -> Iterator[Mutant]:
    """All mutants of a module."""
    text = path.read_text()
    data = text.encode()
    starts = [0, *itertools.accumulate(map(len, data.splitlines(keepends=True)))]
    for node in expressions(ast.parse(text)):
        first, last = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
        for changed in changes(node):
            new = (data[:first] + b"(" + ast.unparse(changed).encode() + b")" + data[last:]).decode()
            before, after = (one.splitlines()[node.lineno - 1].strip() for one in (text, new))
            if new.replace(" ", "") != text.replace(" ", ""):
                yield Mutant(str(path.relative_to(ROOT)), before, after, new)
