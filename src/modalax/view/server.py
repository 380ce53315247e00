"""The page of a session, given by the loopback interface of this machine."""

import threading
from typing import Any

from modalax.view.listener import Listener
from modalax.view.session import Session
from modalax.view.steps import Steps


class Server(Steps):
    """A session on a page of this machine.

    Parameters
    ----------
    session
        What is shown and changed.
    options
        As for :class:`modalax.view.steps.Steps`: name of the data, folder to save in, modes beside, findings.

    Raises
    ------
    ImportError
        If plotly is not installed.
    """

    def __init__(self, session: Session, **options: Any):
        super().__init__(session, **options)
        self.listener = Listener(self)
        threading.Thread(target=self.listener.serve_forever, args=(0.2,), daemon=True).start()

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{self.listener.hosts[0]}/{self.listener.token}/"

    def close(self) -> None:
        """End the page."""
        self.listener.shutdown()
        self.listener.server_close()
