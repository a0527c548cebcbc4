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


def double_click(browser: Any, element: Any) -> None:
    """Click twice in the middle of an element; two clicks by actions may lie too far apart on a slow machine."""
    box = browser.execute_script("return arguments[0].getBoundingClientRect().toJSON()", element)
    place = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "button": "left"}
    for count in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            browser.execute_cdp_cmd("Input.dispatchMouseEvent", {**place, "type": kind, "clickCount": count})
