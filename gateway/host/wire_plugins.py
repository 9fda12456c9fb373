"""Wires from other packages (`gateway.wire`), found by their entry points."""

from collections.abc import Mapping
from importlib.metadata import entry_points

from gateway.text import visible
from gateway.wire import GROUP, Capabilities, ServoWire


def load(name: str, options: Mapping[str, object], built_in: tuple[str, ...]) -> ServoWire:
    """Load the plug-in `name` and return its wire. Raises ValueError if it is missing, broken or rejects `options`."""
    found = {each.name: each for each in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(f'"{each}"' for each in (*built_in, *sorted(found.keys() - {*built_in})))
        raise ValueError(f'there is no wire "{visible(name)}"; installed are {known}')
    named = f'"{name}" ({found[name].value})'
    try:
        made = found[name].load()(options)
    except ValueError:
        raise
    except (Exception, SystemExit) as error:  # a foreign module may raise anything
        raise ValueError(f"{named} cannot be loaded with these options: {type(error).__name__}: {error}") from error
    if not isinstance(made, ServoWire) or not isinstance(made.capabilities, Capabilities):
        raise ValueError(f"{named} is no gateway.wire.ServoWire with its Capabilities")
    return made
