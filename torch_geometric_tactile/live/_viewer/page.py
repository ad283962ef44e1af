r"""The viewer's page, and who gets it."""

import base64
import hashlib
import re
from importlib.resources import files
from typing import Any


class ViewerPage:
    r"""Gives out the page to those who may ask for it, with a policy by which the browser runs and
    loads nothing else.
    """

    def __init__(self) -> None:
        self._page, self._policy = _page()

    def answer(self, connection: Any, request: Any, full: bool) -> Any:
        r"""Returns the answer to a request; :obj:`None` if it may go on as a web socket."""
        path = request.path.partition("?")[0]
        if path == "/live":
            return connection.respond(503, "Too many pages are open.\n") if full else None
        if path != "/":
            return connection.respond(404, "There is only one page: /\n")
        response = connection.respond(200, self._page)
        del response.headers["Content-Type"]
        response.headers.update(self._headers(request.headers["Host"]))
        return response

    def _headers(self, host: str) -> dict[str, str]:
        return {
            "Content-Type": "text/html; charset=utf-8",
            # Some browsers do not count a web socket of the same host as 'self'.
            "Content-Security-Policy": f"{self._policy}; connect-src 'self' ws://{host}",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
        }


def _page() -> tuple[str, str]:
    # The page, and a policy under which nothing runs and nothing is loaded but what is in it.
    page = files(__package__).joinpath("viewer.html").read_text(encoding="utf-8")
    script, style = (
        " ".join(_digest(text) for text in re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL))
        for tag in ("script", "style")
    )
    rules = {
        "default-src": "'none'",
        "script-src": script,
        "style-src": style,
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    return page, "; ".join(f"{name} {value}" for name, value in rules.items())


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
