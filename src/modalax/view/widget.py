"""The page of a session inside a notebook: its messages go through the kernel, so that no port is opened.

The page is the one of :class:`modalax.view.Server`, in a frame of its own. It comes compressed when it is shown, as a
notebook server lets no more than a few megabytes pass at once, and is not stored with the notebook.
"""

import gzip
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from modalax.files.json_text import plain
from modalax.show.report.page import in_script
from modalax.view.session import Session
from modalax.view.steps import HERE, Steps

NEEDS = "a view in a notebook needs anywidget; install it by: pip install 'modalax[notebook]'"
PART = re.compile(r'<link rel="stylesheet" href="([\w.]+)">|<script src="([\w.]+)"></script>')
BRIDGE = '<script src="frame.js"></script>'  # how the page asks when it stands in a frame


class Widget(Steps):
    """A session as the last line of a notebook's cell: poles are picked on the page, and the session follows.

    Parameters
    ----------
    session
        What is shown and changed; after a click its ``model()`` and ``fit()`` are those of the new picks.
    height
        Of the page [pixel].
    options
        As for :class:`modalax.view.steps.Steps`: name of the data, folder to save in, modes beside, findings.

    Raises
    ------
    ImportError
        If plotly or anywidget is not installed.
    """

    def __init__(self, session: Session, *, height: int = 900, **options: Any):
        try:
            import anywidget
            import traitlets
        except ImportError as error:
            raise ImportError(NEEDS) from error
        super().__init__(session, **options)

        class Frame(anywidget.AnyWidget):
            _esm = HERE / "widget.js"
            height = traitlets.Int(900).tag(sync=True)

        self.frame = Frame(height=height)
        self.frame.on_msg(self._on_message)

    def page(self) -> str:
        """The page with all its files in it."""
        html, _ = self.file("") or (b"", "")
        text = html.decode().replace("</title>", f"</title>\n{BRIDGE}")
        return PART.sub(self._inside, text)

    def file(self, name: str) -> tuple[bytes, str] | None:
        """A file of the page and its type; None where there is none."""
        if name == "frame.js":
            return (HERE / name).read_bytes(), "text/javascript"
        return super().file(name)

    def _inside(self, part: re.Match[str]) -> str:
        content, _ = self.file(part[1] or part[2]) or (b"", "")
        text = content.decode()
        return f"<style>{text}</style>" if part[1] else f"<script>{in_script(text)}</script>"

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        data, about = self.frame._repr_mimebundle_(**kwargs) or ({}, {})
        count = len(self.session.state.picks)
        return {**data, "text/plain": f"modalax view of {self.name}: {count} modes (shown where a kernel runs)"}, about

    def _tell(self, step: str) -> None:
        # The kernel answers nothing while a step is under way, so that the step itself tells how far it is.
        super()._tell(step)
        self.frame.send({"progress": step})

    def _on_message(self, widget: Any, content: Mapping[str, Any], buffers: Any) -> None:
        number, name, asked = content.get("number"), str(content.get("name")), content.get("message")
        if name == "page":
            self.frame.send({"number": number}, [_compressed(self.page())])
            return
        try:
            if not isinstance(asked, dict):
                raise ValueError("a message is an object")
            answer = {"value": plain(self.answer(name, asked))}
        except (ValueError, OSError, ImportError) as error:
            answer = {"error": " ".join(str(error).split())}
        except Exception as error:  # a fault of the program: the page tells it, and the notebook goes on
            answer = {"error": f"{type(error).__name__}: {error}"}
        self.frame.send({"number": number, **answer})


@cache
def _compressed(page: str) -> bytes:
    return gzip.compress(page.encode())
