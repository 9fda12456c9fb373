"""Makes the mutants of a file, and reads which of them its comments accept."""

import ast
import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import takewhile
from typing import Final, NamedTuple

from cosmic_ray.mutating import mutate_code

from tests.mutants.operators import operators

_ACCEPTED: Final = re.compile(r"#\s*mutants accepted \(([\w, ]+)\): \S")


@dataclass(frozen=True, slots=True)
class Mutant:
    """A file with one fault in it: what an operator made of which line."""

    line: int
    operator: str
    was: str
    becomes: str
    source: str

    def __str__(self) -> str:
        return f"{self.line}: {self.operator}: {self.was} → {self.becomes}"


class Accepted(NamedTuple):
    """A comment: mutants that no test need notice, by operator, and from which line to which."""

    first: int
    last: int
    operators: frozenset[str]

    def takes(self, mutant: Mutant) -> bool:
        return self.first <= mutant.line <= self.last and mutant.operator in self.operators


def accepted(source: str) -> list[Accepted]:
    """Return what a file's comments accept. One applies to its own line, or to the next; at the first line of a
    function or class, of all of it."""
    wholes = dict(each for node in ast.walk(ast.parse(source)) for each in _wholes(node))
    found: list[Accepted] = []
    for number, line in enumerate(source.splitlines(), start=1):
        if names := _ACCEPTED.search(line):
            place = number + line.lstrip().startswith("#")
            found.append(Accepted(*wholes.get(place, (place, place)), frozenset(names[1].split(", "))))
    return found


def _wholes(node: ast.AST) -> Iterator[tuple[int, tuple[int, int]]]:
    """Yield the lines at which a comment on a function, class or assignment may stand, and the lines that it covers."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        heads = [*(decorator.lineno for decorator in node.decorator_list), node.lineno]
        yield from ((line, (heads[0], node.end_lineno or 0)) for line in heads)
    elif isinstance(node, ast.Assign | ast.AnnAssign):
        yield node.lineno, (node.lineno, node.end_lineno or 0)


def mutants_of(source: str) -> list[Mutant]:
    """Return all of a file's, each fault once.

    Left out is what would be no fault of the program's: another annotation, or how arguments are passed, which mypy
    judges; another promise of a dataclass about itself (`frozen`, `slots`); what mypy alone reads; and what means the
    same as the original, or as a mutant before it.
    """
    seen = {_meaning(source)}
    found: list[Mutant] = []
    for name, operator in operators().items():
        for place in itertools.count():
            mutated = mutate_code(source, operator, place)
            if mutated is None:
                break
            try:
                meaning = _meaning(mutated)
            except SyntaxError:
                continue
            if meaning not in seen:
                seen.add(meaning)
                found.append(_mutant(source, mutated, name))
    return found


def _mutant(source: str, mutated: str, operator: str) -> Mutant:
    lines, others = source.splitlines(), mutated.splitlines()
    first = _alike(lines, others)
    last = _alike(lines[first:][::-1], others[first:][::-1])
    was, becomes = (_in_a_line(text[first : len(text) - last]) for text in (lines, others))
    code = (number for number, line in enumerate(lines[first:], first + 1) if line.strip() and line.lstrip()[0] != "#")
    return Mutant(next(code, first + 1), short(operator), was, becomes, mutated)


def short(operator: str) -> str:
    """Return an operator's name as comments have it: `Step`, `Gt_GtE`."""
    return operator.removeprefix("Replace").split("Operator_")[-1]


def _in_a_line(lines: list[str]) -> str:
    """Return the lines as one, without comments: another comment is not another mutant."""
    text = " ".join(re.sub(r"(^|\s\s)#\s.*", "", line) for line in lines)
    return re.sub(r"([(\[{]) ", r"\1", " ".join(text.split()))


def _alike(lines: list[str], others: list[str]) -> int:
    """Return how many lines at the beginning are the same."""
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(lines, others, strict=False))))


_OPPOSITE: Final[Mapping[type[ast.cmpop], type[ast.cmpop]]] = {
    **{ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn, ast.Lt: ast.GtE, ast.Gt: ast.LtE},
    **{ast.NotEq: ast.Eq, ast.IsNot: ast.Is, ast.NotIn: ast.In, ast.GtE: ast.Lt, ast.LtE: ast.Gt},
}

_NOT_JUDGED: Final = frozenset({"encoding", "strict"})
"""Arguments that only state what holds: text is UTF-8 wherever this runs, and what is zipped is of one length."""


def _meaning(source: str) -> str:
    """Return the syntax without what is not judged, and with a negated comparison written as its opposite."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns = None
            node.decorator_list = _judged(node.decorator_list)
        elif isinstance(node, ast.arguments):
            node.args = node.posonlyargs + node.args + node.kwonlyargs
            node.defaults += [default for default in node.kw_defaults if default is not None]
            node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
        elif isinstance(node, ast.Call):
            node.keywords = [each for each in node.keywords if each.arg not in _NOT_JUDGED]
        elif isinstance(node, ast.ClassDef):
            node.decorator_list = _judged(node.decorator_list)
        for field, value in ast.iter_fields(node):
            if isinstance(value, ast.AST):
                setattr(node, field, _affirmed(value))
            elif isinstance(value, list):
                value[:] = [_affirmed(each) if isinstance(each, ast.AST) else each for each in value]
    return ast.dump(tree)


def _judged(decorators: list[ast.expr]) -> list[ast.expr]:
    """Return the decorators without those for mypy, and without a dataclass's promises about itself."""
    kept = [each for each in decorators if not isinstance(each, ast.Name) or each.id not in ("final", "abstractmethod")]
    for each in kept:
        if isinstance(each, ast.Call) and ast.unparse(each.func) == "dataclass":
            each.keywords.clear()
    return kept


def _affirmed(node: ast.AST) -> ast.AST:
    for_mypy = isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "Callable"
    if for_mypy or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
        return ast.Constant(None)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        negated = node.operand
        if isinstance(negated, ast.Compare) and len(negated.ops) == 1:
            return ast.Compare(negated.left, [_OPPOSITE[type(negated.ops[0])]()], negated.comparators)
    return node
