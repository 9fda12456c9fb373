"""Puts a mutant in the place of a module that is loaded, or is going to be; no file is ever written."""

import ast
import builtins
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from inspect import CO_OPTIMIZED
from types import CodeType, FunctionType, ModuleType
from typing import Final

Place = tuple[str, int]
"""A function or method by qualified name and first line; what stands within one belongs to it."""
CALLED: Final = "__called_in_a_test__"
"""A name among Python's builtins."""


class MutatedImport(MetaPathFinder, Loader):
    """A finder for `sys.meta_path`: loads one module from this source instead of its file."""

    def __init__(self, module: str, file: str, source: str) -> None:
        self._module = module
        self._file = file
        self._source = source

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Implement the import system's hook."""
        del path, target
        return spec_from_loader(name, self, origin=self._file) if name == self._module else None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self._file
        exec(compile(self._source, self._file, "exec"), vars(module))  # noqa: S102  (what an import does)


@dataclass(frozen=True, slots=True)
class Exchange:
    """A loaded function's new code. Calling it exchanges the code."""

    place: Place
    functions: list[FunctionType]
    code: CodeType

    def __call__(self) -> None:
        for function in self.functions:
            function.__code__ = self.code


def in_place(module: ModuleType, source: str, mutated: str) -> Exchange | None:
    """Return the exchange of the one function that differs; None if it is not one, or not found."""
    file = str(module.__file__)
    was, is_now = compile(source, file, "exec"), compile(mutated, file, "exec")
    functions, others = dict(_functions(was)), dict(_functions(is_now))
    changed = [place for place, code in functions.items() if others.get(place) != code]
    if len(changed) != 1 or functions.keys() != others.keys() or _frame(was) != _frame(is_now):
        return None
    return _exchange(module, changed[0], others[changed[0]])


def watched(module: ModuleType, source: str, called: Callable[[int], None]) -> list[Exchange]:
    """Return exchanges by which each function reports its first line whenever it is called, in any thread."""
    setattr(builtins, CALLED, called)
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            line = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            node.body[:0] = ast.parse(f"{CALLED}({line})").body
    code = compile(ast.fix_missing_locations(tree), str(module.__file__), "exec")
    exchanges = [_exchange(module, place, function) for place, function in _functions(code)]
    return [each for each in exchanges if each is not None]


def _exchange(module: ModuleType, place: Place, code: CodeType) -> Exchange | None:
    functions = [each for each in _loaded(vars(module), module.__name__) if _place(each.__code__) == place]
    if not functions or any(len(each.__code__.co_freevars) != len(code.co_freevars) for each in functions):
        return None
    return Exchange(place, functions, code)


def _place(code: CodeType) -> Place:
    return code.co_qualname, code.co_firstlineno


def _functions(code: CodeType) -> Iterator[tuple[Place, CodeType]]:
    """Yield the functions of a module's or a class's body, with their places."""
    for const in code.co_consts:
        if isinstance(const, CodeType):
            if const.co_flags & CO_OPTIMIZED:
                yield _place(const), const
            else:
                yield from _functions(const)


def _frame(code: CodeType) -> CodeType:
    """Return the body of a module, and those of its classes, without its functions."""
    consts = [
        (None if const.co_flags & CO_OPTIMIZED else _frame(const)) if isinstance(const, CodeType) else const
        for const in code.co_consts
    ]
    return code.replace(co_consts=tuple(consts))


def _loaded(names: dict[str, object], module: str) -> Iterator[FunctionType]:
    """Yield the functions behind these names, as they are called: behind decorators, properties and classes, too."""
    for value in list(names.values()):
        for function in (value, getattr(value, "fget", None), getattr(value, "__func__", None)):
            wrapped = getattr(function, "__wrapped__", function)
            if isinstance(wrapped, FunctionType) and wrapped.__module__ == module:
                yield wrapped
        if isinstance(value, type) and value.__module__ == module:
            yield from _loaded(dict(vars(value)), module)
