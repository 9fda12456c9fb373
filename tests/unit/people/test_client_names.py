"""What tools see of the client: completion, help and autospecs show each public method."""

import inspect
from unittest.mock import create_autospec

from gateway.client import Client


def test_tools_that_list_the_clients_names_see_each_method() -> None:
    methods = {name for name, _ in inspect.getmembers_static(Client) if not name.startswith("_")}
    assert methods <= set(dir(Client))
    assert {"lease", "button", "on_state"} <= set(dir(create_autospec(Client)))
