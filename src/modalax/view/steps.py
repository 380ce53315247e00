"""The messages by which the steps of a session are asked for and answered, and the files that its page is made of."""

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from modalax._numerics.threads import one_thread
from modalax.show.report.page import plotly_script, shape_script
from modalax.view.answers import SUM, Answers
from modalax.view.beside import Beside
from modalax.view.files import place, save
from modalax.view.session import Session

HERE = Path(__file__).parent
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
NEEDS = "a view needs plotly; install it by: pip install 'modalax[view]'"


class Steps:
    """What a page asks of a session, step by step, and what it is answered.

    Parameters
    ----------
    session
        What is shown and changed.
    name
        Name of the data, for headings and file names.
    folder
        Where files are saved.
    inputs
        Files that were read, which are never written to.
    beside
        Modes to compare with.
    findings
        Gives the findings of a check; called once, aside, while the page is used already.

    Raises
    ------
    ImportError
        If plotly is not installed.
    """

    def __init__(
        self,
        session: Session,
        *,
        name: str = "data",
        folder: Path | None = None,
        inputs: Sequence[Path] = (),
        beside: Beside | None = None,
        findings: Callable[[], Any] | None = None,
    ):
        try:
            self._plotly = plotly_script().encode()
        except ImportError as error:
            raise ImportError(NEEDS) from error
        self.session, self.answers, self.name = session, Answers(session, beside), name
        self.folder, self.inputs = (folder or Path.cwd()).absolute(), tuple(inputs)
        self.unsaved = False
        self._told: dict[str, Any] = {"ready": findings is None, "findings": [], "about": []}
        self._step = ""
        session.tell = self._tell
        self._lock = threading.Lock()
        if findings is not None:
            threading.Thread(target=self._check, args=(findings,), daemon=True).start()

    def file(self, name: str) -> tuple[bytes, str] | None:
        """A file of the page and its type; None where there is none."""
        made = {"plotly.js": lambda: self._plotly, "shape.js": lambda: shape_script().encode()}
        if name in made:
            return made[name](), KINDS[".js"]
        if name in ("", "view.js", "view.css"):
            path = HERE / (name or "view.html")
            return path.read_bytes(), KINDS[path.suffix]
        return None

    def answer(self, name: str, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Answer a message of the page.

        Raises
        ------
        ValueError
            If the message cannot be understood or the step not be done.
        """
        if name == "progress":
            return {"step": self._step}
        if name == "findings":
            return self._told
        with self._lock:
            try:
                return self._answer(name, asked)
            finally:
                self._step = ""

    @one_thread
    def _answer(self, name: str, asked: Mapping[str, Any]) -> dict[str, Any]:
        session = self.session
        if name == "opening":
            return self.answers.opening() | {"name": self.name, "folder": str(self.folder), "stem": _stem(self.name)}
        if name == "diagram":
            return self.answers.diagram()
        if name == "save":
            path = place(self.folder, str(asked.get("name", "")), asked.get("replace") is True, self.inputs)
            save(session, str(asked.get("what")), path, asked.get("replace") is True, self.name)
            self.unsaved = False
            return {"saved": str(path)}
        steps: dict[str, Callable[[], None]] = {
            "now": lambda: None,
            "pick": lambda: session.pick(int(asked["order"]), float(asked["f"])),
            "drop": lambda: session.drop(int(asked["number"])),
            "name": lambda: session.name(int(asked["number"]), str(asked["text"])),
            "clear": session.clear, "choose": session.choose, "refine": session.refine, "undo": session.undo,
            "redo": session.redo,
            "look": lambda: session.look(_band(asked.get("band")), _order(asked.get("order"))),
        }  # fmt: skip
        if name not in steps:
            raise ValueError(f"there is no step {name!r}")
        before = session.state
        try:
            steps[name]()
        except (KeyError, TypeError) as error:
            raise ValueError(f"the message for {name!r} lacks a number: {error}") from error
        self.unsaved = self.unsaved or session.state is not before
        mode = asked.get("mode", 1)
        return self.answers.now(asked.get("channel", SUM), mode if isinstance(mode, int) else 1)

    def _tell(self, step: str) -> None:
        self._step = step

    def _check(self, findings: Callable[[], Any]) -> None:
        try:
            found = findings()
            self._told = {"ready": True, **found.to_dict(), "about": list(found.about)}
        except Exception as error:  # whatever it is, the page goes on without findings and says why
            self._told = {"ready": True, "findings": [], "about": [f"the check could not be done: {error}"]}


def _stem(name: str) -> str:
    return Path(name).stem or "modes"


def _band(value: Any) -> tuple[float, float] | None:
    return None if value is None else (float(value[0]), float(value[1]))


def _order(value: Any) -> int | None:
    return None if value is None else int(value)
