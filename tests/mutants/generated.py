"""Makes the mutants of a file, and names each so that it keeps its name when lines move."""

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Final

import parso
from cosmic_ray.ast import ast_nodes
from parso.tree import BaseNode, Leaf, NodeOrLeaf

from tests.mutants.operators import operators

ACCEPTED: Final = Path(__file__).with_name("accepted.toml")
MODULE_LEVEL: Final = "module"
"""In the place of a function's name."""


@dataclass(frozen=True, slots=True)
class Name:
    """Which mutant of a file this is: what was changed in which function, not in which line."""

    function: str
    operator: str
    was: str
    becomes: str
    nth: int = 1
    """Which one, where a function has several lines alike."""

    def __str__(self) -> str:
        again = f" #{self.nth}" if self.nth > 1 else ""
        operator = self.operator.removeprefix("Replace").split("Operator_")[-1]
        return f"{self.function} · {operator} · {self.was} → {self.becomes}{again}"


@dataclass(frozen=True, slots=True)
class Mutant:
    """A file with one fault in it."""

    name: Name
    source: str


def accepted(file: str) -> dict[str, str]:
    """Those mutants of a file, by name, that no test need notice, and why."""
    groups = tomllib.loads(ACCEPTED.read_text(encoding="utf-8")).get(file, [])
    return {name: group["why"] for group in groups for name in group["mutants"]}


def mutants_of(source: str) -> list[Mutant]:
    """All of a file's, each fault once.

    Left out is what would be no fault of the program's: another annotation, or how arguments are passed, which mypy
    judges; another promise of a dataclass about itself (`frozen`, `slots`); and what means the same as the original, or
    as a mutant before it.
    """
    seen = {_meaning(source)}
    counted: Counter[Name] = Counter()
    found: list[Mutant] = []
    functions = ast.parse(source)
    for operator, mutated in mutations(source):
        try:
            meaning = _meaning(mutated)
        except SyntaxError:
            continue
        if meaning not in seen:
            seen.add(meaning)
            name = _name(functions, source, mutated, operator)
            counted[name] += 1
            found.append(Mutant(replace(name, nth=counted[name]), mutated))
    return found


def mutations(source: str) -> Iterator[tuple[str, str]]:
    """Operators by name, each with one mutated source that it makes.

    As cosmic-ray's `mutate_code`, which parses the file anew for each of them: half a minute for a long one.
    """
    tree = parso.parse(source)
    nodes = list(ast_nodes(tree))
    for name, operator in operators().items():
        for node in nodes:
            for index in range(len(list(operator.mutation_positions(node)))):
                with _as_it_is(node):
                    mutated = operator.mutate(node, index)
                    yield name, _exchanged(tree, node, mutated)


@contextmanager
def _as_it_is(node: NodeOrLeaf) -> Iterator[None]:
    """Afterwards the node, and what it is made of, is as before."""
    kept = list(node.children) if isinstance(node, BaseNode) else []
    leaves = [(leaf, leaf.value, leaf.prefix) for leaf in (node, *kept) if isinstance(leaf, Leaf)]
    yield
    if isinstance(node, BaseNode):
        node.children = kept
    for leaf, value, prefix in leaves:
        leaf.value, leaf.prefix = value, prefix


def _exchanged(tree: BaseNode, node: NodeOrLeaf, mutated: NodeOrLeaf | None) -> str:
    """The source with another node, or none, in the place of this one."""
    parent = node.parent
    assert parent is not None
    kept = parent.children
    place = [each is node for each in kept].index(True)
    parent.children = [*kept[:place], *([] if mutated is None else [mutated]), *kept[place + 1 :]]
    source: str = tree.get_code()
    parent.children = kept
    return source


def _name(functions: ast.Module, source: str, mutated: str, operator: str) -> Name:
    lines, others = source.splitlines(), mutated.splitlines()
    first = _alike(lines, others)
    last = _alike(lines[first:][::-1], others[first:][::-1])
    was, becomes = (_in_a_line(text[first : len(text) - last]) for text in (lines, others))
    return Name(_function_at(functions, first + 1), operator, was, becomes)


def _in_a_line(lines: list[str]) -> str:
    """Without comments, so that another comment is no other mutant."""
    return (
        " ".join(" ".join(re.sub(r"(^|\s\s)#\s.*", "", line) for line in lines).split())
        .replace("( ", "(")
        .replace("[ ", "[")
        .replace("{ ", "{")
    )


def _alike(lines: list[str], others: list[str]) -> int:
    """How many lines at the beginning are the same."""
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(lines, others, strict=False))))


def _function_at(tree: ast.AST, line: int) -> str:
    """The qualified name of the class or function that this line stands in."""
    parts: list[str] = []
    inside: ast.AST | None = tree
    while inside is not None:
        inside = next(
            (
                node
                for node in ast.iter_child_nodes(inside)
                if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
                and min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)]) <= line
                and line <= (node.end_lineno or 0)
            ),
            None,
        )
        if inside is not None:
            parts.append(inside.name)
    return ".".join(parts) or MODULE_LEVEL


_OPPOSITE: Final[Mapping[type[ast.cmpop], type[ast.cmpop]]] = {
    **{ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn, ast.Lt: ast.GtE, ast.Gt: ast.LtE},
    **{ast.NotEq: ast.Eq, ast.IsNot: ast.Is, ast.NotIn: ast.In, ast.GtE: ast.Lt, ast.LtE: ast.Gt},
}


_NOT_JUDGED: Final = frozenset({"encoding", "strict"})
"""Arguments that only state what holds: text is UTF-8 wherever this runs, and what is zipped is of one length."""


def _meaning(source: str) -> str:
    """The syntax without what is not judged, and with a negated comparison written as its opposite."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns = None
        elif isinstance(node, ast.arguments):
            node.args = node.posonlyargs + node.args + node.kwonlyargs
            node.defaults += [default for default in node.kw_defaults if default is not None]
            node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
        elif isinstance(node, ast.Call):
            node.keywords = [each for each in node.keywords if each.arg not in _NOT_JUDGED]
        elif isinstance(node, ast.ClassDef):
            for decorator in node.decorator_list:
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "dataclass":
                    decorator.keywords.clear()
        for field, value in ast.iter_fields(node):
            if isinstance(value, ast.AST):
                setattr(node, field, _affirmed(value))
            elif isinstance(value, list):
                value[:] = [_affirmed(each) if isinstance(each, ast.AST) else each for each in value]
    return ast.dump(tree)


def _affirmed(node: ast.AST) -> ast.AST:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        negated = node.operand
        if isinstance(negated, ast.Compare) and len(negated.ops) == 1:
            return ast.Compare(negated.left, [_OPPOSITE[type(negated.ops[0])]()], negated.comparators)
    return node
