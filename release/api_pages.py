"""The docs site's pages of the Python API: an extension of griffe, which mkdocs.yml names. `make docs` builds it."""

import re
from collections.abc import Iterator
from copy import copy
from importlib import import_module
from inspect import iscoroutinefunction, isfunction
from typing import Any, Final

import griffe

DOCTEST: Final = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)


class PublicApi(griffe.Extension):
    """Shows methods as they are when a program runs, and none marked `@private`."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Change a package once it was read."""
        for module in pkg.modules["people"].modules["client"].modules.values() if pkg.path == "gateway" else ():
            _complete(pkg, module)
        owners = list(_owners(pkg))
        private = [(owner, name) for owner in owners for name in owner.members if _is_private(owner, name)]
        for owner, name in private:
            owner.del_member(name)
        for owner in owners:
            if owner.docstring:
                owner.docstring.value = DOCTEST.sub(r"```pycon\n\g<0>\n```", owner.docstring.value)


def _owners(owner: griffe.Object) -> Iterator[griffe.Object]:
    """Yield this module or class, and all modules, classes and functions in it."""
    yield owner
    for member in owner.members.values():
        if isinstance(member, griffe.Object):
            yield from _owners(member)


def _complete(package: griffe.Module, module: griffe.Module) -> None:
    """Show a method that is made at import (`go = waits(Walk.go)`) as the method that it is made of."""
    made = [
        (owner, name)
        for owner in module.classes.values()
        if not owner.is_alias
        for name, member in owner.members.items()
        if (name == "__init__" or not name.startswith("_"))
        and isinstance(member, griffe.Attribute)
        and isinstance(member.value, griffe.ExprCall)
    ]
    for owner, name in made:
        method = getattr(getattr(import_module(module.path), owner.name), name, None)
        if isfunction(method) and "<locals>" not in method.__qualname__:  # else a lambda, with no text of its own
            function = copy(package[method.__module__.removeprefix(f"{package.path}.")][method.__qualname__])
            function.labels = {*function.labels, *(("async",) if iscoroutinefunction(method) else ())}
            owner.set_member(name, function)


def _is_private(owner: griffe.Object, name: str) -> bool:
    """Return whether it is marked; without a docstring, whether what it overrides is."""
    member = owner.members.get(name)
    if isinstance(member, griffe.Object) and member.docstring:
        return "@private" in member.docstring.value
    return isinstance(owner, griffe.Class) and any(_is_private(base, name) for base in owner.resolved_bases)
