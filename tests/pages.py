"""What tests of pages in a browser share."""

from typing import Any

_FRAMES = """
const done = arguments[arguments.length - 1];
requestAnimationFrame(() => requestAnimationFrame(() => done(true)));
"""


def settle(browser: Any) -> None:
    """Wait until the page has drawn what it knows by now: two frames."""
    browser.execute_async_script(_FRAMES)


def errors(browser: Any) -> list[str]:
    """What pages said on the console as errors, since this was asked last."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
