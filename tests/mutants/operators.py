"""Which faults are made: operators of cosmic-ray that each stand for a mistake, and a few of our own.

An operator has `mutation_positions(node)` and `mutate(node, index)` on parso's tree, as cosmic-ray's documentation of
"operators" describes it.
"""

import ast
import re
from collections.abc import Iterator
from typing import Final, Protocol

from cosmic_ray.operators.provider import OperatorProvider
from parso.python.tree import Keyword, Newline, Number, String
from parso.tree import BaseNode, NodeOrLeaf

Span = tuple[tuple[int, int], tuple[int, int]]
"""First and last line and column."""

SCALED_FROM: Final = 256
"""A time, a size or a rate that large is doubled and halved: one more of its units is nothing that a test could see."""


class Operator(Protocol):
    """One kind of fault."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Where it can be made in this node; the same place twice, where it can be made there in two ways."""

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """The node with this fault, which may be the same object."""


class Forget:
    """A statement whose effect is missing: a call, an assignment to what outlives the function, raise, del, return.

    Its lines stay, so that all others keep their numbers.
    """

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """All but docstrings, and assignments to names of the function's own."""
        if isinstance(node, BaseNode) and node.type == "simple_stmt" and _has_effect(node.children[0]):
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """`pass`, and as many lines as there were."""
        assert isinstance(node, BaseNode)
        assert index == 0
        lines = node.get_code(include_prefix=False).count("\n")
        prefix = node.get_first_leaf().prefix
        node.children = [Keyword("pass", node.start_pos, prefix), Newline("\n" * lines, node.end_pos, "")]
        return node


class IgnoreGuard:
    """`case … if …:` without its condition; parso knows no `match`, so this one looks at the words."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Each `if` that has a `case` before it in its line."""
        if isinstance(node, Keyword) and node.value == "if" and _in_a_case(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """`if True or …`."""
        assert isinstance(node, Keyword)
        assert index == 0
        node.value = "if True or"
        return node


class CatchNothing:
    """`except ():`; cosmic-ray's operator for this knows no names with dots."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Each `except …`."""
        if isinstance(node, BaseNode) and node.type == "except_clause":
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """The clause with no exception."""
        assert isinstance(node, BaseNode)
        assert index == 0
        exception = node.children[1]
        node.children = [node.children[0], Keyword("()", exception.start_pos, " "), *node.children[2:]]
        return node


class LeaveOut:
    """A named argument that is not given, an element that is missing."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Each of a list, set, tuple or call that has several in brackets, and a call's only one."""
        if isinstance(node, BaseNode):
            yield from ((each.start_pos, each.end_pos) for each in _dispensable(node))

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """The rest, with the commas that stand between."""
        assert isinstance(node, BaseNode)
        gone = _dispensable(node)[index]
        place = node.children.index(gone)
        last = place + 1 == len(node.children) and place > 0
        comma = node.children[1]
        node.children = [*node.children[: place - last], *node.children[place + 2 - last - (node.type == "trailer") :]]
        if node.type == "testlist_comp" and len(node.children) == 1:
            node.children.append(comma)  # else a tuple of one would be none
        return node


def _dispensable(node: BaseNode) -> list[NodeOrLeaf]:
    children: list[NodeOrLeaf] = node.children
    if node.type in ("arglist", "trailer"):
        return [
            each
            for each in node.children
            if each.type == "argument" and "=" in (leaf.get_code() for leaf in each.children)
        ]
    sign = children[1] if len(children) > 2 else node
    if node.type in ("testlist_comp", "dictorsetmaker") and sign.get_code() == ",":
        return children[::2]
    return []


class Step:
    """A small number: one more, and one less, by cosmic-ray's operator."""

    _theirs = OperatorProvider()["NumberReplacer"]()

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Twice for each number below `SCALED_FROM`."""
        if isinstance(node, Number) and not _is_large(node):
            yield from self._theirs.mutation_positions(node)

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """The other number."""
        stepped: NodeOrLeaf = self._theirs.mutate(node, index)
        return stepped


class Scale:
    """A large number: twice, and half."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Twice for each number from `SCALED_FROM` on."""
        if isinstance(node, Number) and _is_large(node):
            yield node.start_pos, node.end_pos
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """In brackets, since it may stand beside an operator."""
        assert isinstance(node, Number)
        node.value = f"({node.value} {('* 2', '// 2')[index]})"
        return node


class Flip:
    """A `true` or a `false` in a text of several lines, such as the template of a configuration."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """Each of them, but not in docstrings."""
        if isinstance(node, String) and node.parent is not None and node.parent.type != "simple_stmt":
            yield from ((node.start_pos, node.end_pos) for _ in _flags(node))

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:
        """The text with the other word."""
        assert isinstance(node, String)
        flag = _flags(node)[index]
        other = "false" if flag.group() == "true" else "true"
        node.value = node.value[: flag.start()] + other + node.value[flag.end() :]
        return node


def _flags(text: String) -> list[re.Match[str]]:
    return list(re.finditer(r"\b(true|false)\b", text.value)) if "\n" in text.value else []


def _is_large(number: Number) -> bool:
    value: float = ast.literal_eval(number.value)
    return value >= SCALED_FROM


def _has_effect(statement: NodeOrLeaf) -> bool:
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


def operators() -> dict[str, Operator]:
    """All of them by name."""
    provider = OperatorProvider()
    theirs: dict[str, Operator] = {name: provider[name]() for name in _NAMES}
    ours: tuple[Operator, ...] = (CatchNothing(), Flip(), Forget(), IgnoreGuard(), LeaveOut(), Scale(), Step())
    return theirs | {type(operator).__name__: operator for operator in ours}
