"""Which faults are made: operators of cosmic-ray that each stand for a mistake, and a few of our own.

An operator has `mutation_positions(node)` and `mutate(node, index)` on parso's tree, as cosmic-ray's documentation of
"operators" describes it.
"""

import ast
import re
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from cosmic_ray.operators.provider import OperatorProvider
from parso.python.tree import Keyword, Newline, Number
from parso.tree import BaseNode, NodeOrLeaf

Span = tuple[tuple[int, int], tuple[int, int]]
"""First and last line and column."""

SCALED_FROM: Final = 256
"""A time, a size or a rate that large is doubled and halved: one more of its units is nothing that a test could see."""


class Ours(NamedTuple):
    """An operator of our own: a place comes twice where it can be made there in two ways."""

    ways: Callable[[Any], int]
    """Returns in how many ways the fault can be made in a node."""
    change: Callable[[Any, int], Any]

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        yield from [(node.start_pos, node.end_pos)] * self.ways(node)

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        changed: NodeOrLeaf = self.change(node, index)
        return changed


def _forget(node: Any, _: int) -> Any:
    """Replace a statement by `pass` with as many lines, so that all others keep their numbers."""
    lines = node.get_code(include_prefix=False).count("\n")
    prefix = node.get_first_leaf().prefix
    node.children = [Keyword("pass", node.start_pos, prefix), Newline("\n" * lines, node.end_pos, "")]
    return node


def _ignore_guard(node: Any, _: int) -> Any:
    """Make it `case … if True or …`. parso knows no `match`, so this one looks at the words."""
    node.value = "if True or"
    return node


def _catch_nothing(node: Any, _: int) -> Any:
    """Make it `except ():`. cosmic-ray's operator for this knows no names with dots."""
    exception = node.children[1]
    node.children = [node.children[0], Keyword("()", exception.start_pos, " "), *node.children[2:]]
    return node


def _leave_out(node: Any, index: int) -> Any:
    """Leave out a named argument or an element, with one of the commas between."""
    gone = _dispensable(node)[index]
    place = node.children.index(gone)
    last = place + 1 == len(node.children) and place > 0
    comma = node.children[1]
    node.children = [*node.children[: place - last], *node.children[place + 2 - last - (node.type == "trailer") :]]
    if node.type == "testlist_comp" and len(node.children) == 1:
        node.children.append(comma)  # else a tuple of one would be none
    return node


def _dispensable(node: Any) -> list[Any]:
    """Return the elements and named arguments that may be left out: each of several, or a call's only argument."""
    if not isinstance(node, BaseNode):
        return []
    children: list[Any] = node.children
    if node.type in ("arglist", "trailer"):
        return [
            each for each in children if each.type == "argument" and "=" in (leaf.get_code() for leaf in each.children)
        ]
    sign = children[1] if len(children) > 2 else node
    if node.type in ("testlist_comp", "dictorsetmaker") and sign.get_code() == ",":
        return children[::2]
    return []


def _scale(node: Any, index: int) -> Any:
    """Double a large number, or halve it; in brackets, since it may stand next to an operator."""
    node.value = f"({node.value} {('* 2', '// 2')[index]})"
    return node


def _flip(node: Any, index: int) -> Any:
    """Exchange a `true` and a `false` in a text of several lines, such as the template of a configuration."""
    flag = _flags(node)[index]
    other = "false" if flag.group() == "true" else "true"
    node.value = node.value[: flag.start()] + other + node.value[flag.end() :]
    return node


def _flags(node: Any) -> list[re.Match[str]]:
    """Return each `true` and `false` in a string of several lines that is not a docstring."""
    is_text = node.type == "string" and "\n" in node.value and node.parent.type != "simple_stmt"
    return list(re.finditer(r"\b(true|false)\b", node.value)) if is_text else []


def _is_number(node: Any, *, large: bool) -> bool:
    value = ast.literal_eval(node.value) if isinstance(node, Number) else None
    return isinstance(value, int | float) and (value >= SCALED_FROM) is large


def _has_effect(statement: NodeOrLeaf) -> bool:
    """Return whether a statement has an effect: a call, an assignment beyond the function, raise, del, return."""
    match statement.type:
        case "atom_expr" | "raise_stmt" | "del_stmt":
            return True
        case "keyword":
            return statement.get_code(include_prefix=False) in ("return", "raise")
        case "expr_stmt":
            assert isinstance(statement, BaseNode)
            target, sign = statement.children[:2]
            return sign.type == "operator" and bool(target.type == "atom_expr" or sign.get_code().strip() != "=")
        case _:
            return False


def _in_a_case(word: NodeOrLeaf) -> bool:
    leaf = word.get_previous_leaf()
    while leaf is not None and leaf.start_pos[0] == word.start_pos[0]:
        if leaf.get_code(include_prefix=False) == "case":
            return True
        leaf = leaf.get_previous_leaf()
    return False


_REPLACED: Final = (
    *("Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is"),
    *("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt", "Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt"),
)
_COMPUTED: Final = (
    *("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul", "Mod_Mul", "Pow_Mul"),
    *("LShift_RShift", "RShift_LShift", "BitOr_BitAnd", "BitAnd_BitOr", "BitXor_BitOr"),
)
_OTHERS: Final = (
    *("AddNot", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
    *("ReplaceUnaryOperator_Delete_Not", "ReplaceUnaryOperator_Delete_USub"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
    "RemoveDecorator",
)
_NAMES: Final = (
    *(f"ReplaceComparisonOperator_{change}" for change in _REPLACED),
    *(f"ReplaceBinaryOperator_{change}" for change in _COMPUTED),
    *_OTHERS,
)
"""One replacement for each sign, two for those that have a border: all of cosmic-ray's would be three times as many,
and say nothing else (whoever notices `-` for `+` notices `**`, too)."""

_STEPS: Final = OperatorProvider()["NumberReplacer"]()
_OURS: Final[dict[str, Any]] = {
    "CatchNothing": Ours(lambda node: node.type == "except_clause", _catch_nothing),
    "Flip": Ours(lambda node: len(_flags(node)), _flip),
    "Forget": Ours(lambda node: node.type == "simple_stmt" and _has_effect(node.children[0]), _forget),
    "IgnoreGuard": Ours(
        lambda node: isinstance(node, Keyword) and node.value == "if" and _in_a_case(node), _ignore_guard
    ),
    "LeaveOut": Ours(lambda node: len(_dispensable(node)), _leave_out),
    "Scale": Ours(lambda node: 2 * _is_number(node, large=True), _scale),
    # A small number: one more, and one less, by cosmic-ray's operator.
    "Step": Ours(lambda node: 2 * _is_number(node, large=False), _STEPS.mutate),
}


def operators() -> dict[str, Any]:
    provider = OperatorProvider()
    return {name: provider[name]() for name in _NAMES} | _OURS
