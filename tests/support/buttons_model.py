"""The buttons in the model check: what may be asked of them, how they are copied, what of them tells states apart."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from gateway.robot.core.buttons import Buttons
from gateway.robot.core.events import ButtonDo, ButtonRequest, Event
from gateway.robot.core.pacing import NS_PER_MS
from tests.support.buttons_history import ButtonsHistory
from tests.support.history import cloned


def copied_buttons(buttons: Buttons) -> Buttons:
    """A copy that shares nothing that changes."""
    by_token = {token: replace(button) for token, button in buttons._by_token.items()}
    return cloned(buttons, _by_token=by_token, changes=buttons.changes.copy())


def buttons_key(buttons: Buttons, now_ns: int) -> tuple[object, ...]:
    """What of them can still matter; one token, and one count, is as good as another."""
    each = tuple(
        (button.name, button.until_ns and button.until_ns - now_ns, button.silent, button.offset_ns)
        for button in buttons._by_token.values()
    )
    return each, buttons.closed, buttons.due_ns and buttons.due_ns - now_ns


def button_requests(
    names: Sequence[str], number: int, now_ns: int, delays_ns: Sequence[int], buttons: ButtonsHistory
) -> Iterator[tuple[str, Event]]:
    """Everything that each of them may want `now`; a new token is one that nobody had.

    A check-in is the next one, or the latest one again; it says when it was sent (so long ago), or does not.
    """
    for name in names:
        register = ButtonRequest(ButtonDo.REGISTER, now_ns, name, fresh_token=f"token {number}")
        yield f"{name} registers", register
        for delay_ns in delays_ns:
            yield f"{name} registers, {delay_ns} late", replace(register, sent_ms=(now_ns - delay_ns) / NS_PER_MS)
    tokens = [*buttons.known, *([] if buttons.old_token is None else [buttons.old_token])]
    for token in tokens if names else ():
        whose = buttons.known[token].name if token in buttons.known else "a former button"
        count = buttons.known[token].count if token in buttons.known else number
        alive = ButtonRequest(ButtonDo.ALIVE, now_ns, token=token, count=count + 1)
        yield f"{whose} is alive", alive
        yield f"a check-in of {whose} once more", replace(alive, count=count)
        for delay_ns in delays_ns:
            yield f"{whose} was alive {delay_ns} ago", replace(alive, sent_ms=(now_ns - delay_ns) / NS_PER_MS)
        yield f"{whose} leaves", ButtonRequest(ButtonDo.LEAVE, now_ns, token=token)
