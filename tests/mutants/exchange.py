"""Puts a mutant in the place of a module that is loaded, or is going to be; no file is ever written."""

from collections.abc import Callable, Iterator, Set
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_loader
from inspect import CO_OPTIMIZED
from types import CodeType, FunctionType, ModuleType

CodesByPlace = dict[tuple[str, int], CodeType]
"""Functions, those of classes, too, by qualified name and first line; what stands within one belongs to it."""


class MutatedImport:
    """A finder for `sys.meta_path`: one module comes from this source instead of its file."""

    def __init__(self, module: str, file: str, source: str) -> None:
        self._module = module
        self._loader = _Loader(module, file, source.encode())

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """The import system's hook."""
        del path, target
        return spec_from_loader(name, self._loader) if name == self._module else None


class _Loader(SourceFileLoader):
    """Has its own source, and no bytecode of the file's."""

    def __init__(self, module: str, file: str, source: bytes) -> None:
        super().__init__(module, file)
        self._source = source

    def get_data(self, path: str) -> bytes:
        if path.endswith(".py"):
            return self._source
        raise OSError("a mutant has no bytecode")

    def set_data(self, path: str, data: object, *, _mode: int = 0o666) -> None:
        """Keeps none, either."""


def in_place(module: ModuleType, source: str, mutated: str, called: Set[CodeType]) -> Callable[[], None] | None:
    """What gives the one function that differs its mutated code.

    None: it is more than one, one that is not found, or one that has been `called` already.
    """
    file = str(module.__file__)
    was, is_now = compile(source, file, "exec"), compile(mutated, file, "exec")
    functions, others = dict(_functions(was)), dict(_functions(is_now))
    changed = [place for place, code in functions.items() if others.get(place) != code]
    if len(changed) != 1 or functions.keys() != others.keys() or _frame(was) != _frame(is_now):
        return None
    found = [each for each in _loaded(vars(module), module.__name__) if _place(each.__code__) == changed[0]]
    code = others[changed[0]]
    if not found or any(len(each.__code__.co_freevars) != len(code.co_freevars) for each in found):
        return None
    if called & {each.__code__ for each in found}:
        return None

    def exchange() -> None:
        for each in found:
            each.__code__ = code

    return exchange


def _place(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno


def _functions(code: CodeType) -> Iterator[tuple[tuple[str, int], CodeType]]:
    """Of a module or a class's body."""
    for const in code.co_consts:
        if isinstance(const, CodeType):
            if const.co_flags & CO_OPTIMIZED:
                yield _place(const), const
            else:
                yield from _functions(const)


def _frame(code: CodeType) -> CodeType:
    """The body of a module, and those of its classes, without its functions."""
    consts = [
        (None if const.co_flags & CO_OPTIMIZED else _frame(const)) if isinstance(const, CodeType) else const
        for const in code.co_consts
    ]
    return code.replace(co_consts=tuple(consts))


def _loaded(names: dict[str, object], module: str) -> Iterator[FunctionType]:
    """The functions behind these names, as they are called: behind decorators, properties and classes, too."""
    for value in list(names.values()):
        for function in (value, getattr(value, "fget", None), getattr(value, "__func__", None)):
            wrapped = getattr(function, "__wrapped__", function)
            if isinstance(wrapped, FunctionType) and wrapped.__module__ == module:
                yield wrapped
        if isinstance(value, type) and value.__module__ == module:
            yield from _loaded(dict(vars(value)), module)
