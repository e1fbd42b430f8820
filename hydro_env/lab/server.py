"""The web server of `hydro-env lab`: the page, uploads and results, on the loopback address only."""

import asyncio
import os
import re
import secrets
import signal
import socket
import webbrowser
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, PlainTextResponse, Response
from nicegui import ui

from hydro_env.errors import InputError
from hydro_env.files import write_text
from hydro_env.lab.diagnosis_page import DiagnosisPage
from hydro_env.lab.guard import Guard
from hydro_env.lab.jobs import Jobs
from hydro_env.lab.live_page import LivePage
from hydro_env.lab.page import RigPage
from hydro_env.lab.session import Session, Settings
from hydro_env.lab.uploads import YAML_ENDINGS, Uploads
from hydro_env.lab.worker import Worker

HOST = "127.0.0.1"
#: Files of a diagnosis that the page links to.
RESULTS = ("report.html", "diagnosis.json", "model.yaml")
TITLE = "hydro_env lab"


class Lab:
    """All that a lab has beside its page: the session at work, the files, the diagnosis. `out` is where logs and reports go."""

    def __init__(self, out: Path, session: Session | None = None) -> None:
        self.out, self.told = out, f"Logs and reports go to {out}."
        self.uploads, self.jobs = Uploads(), Jobs(out)
        session = session or Session()
        self.worker = Worker(session, self._keep_log)
        path = Path(session.settings.preset)
        if path.suffix in YAML_ENDINGS:
            self.uploads.add(path, path.name, "model")

    def _keep_log(self, text: str) -> None:
        self.out.mkdir(parents=True, exist_ok=True)
        path = next(path for n in count(1) if not (path := self.out / f"log_{n}.csv").exists())
        write_text(path, text)
        self.uploads.add(path, path.name, "fit")

    def start(self) -> None:
        """Lets the session run."""
        self.worker.start()

    def add_routes(self, app: FastAPI) -> None:
        """Uploads and results."""
        app.add_route("/upload", self._upload, methods=["POST"])
        app.add_route("/results/{folder}/{file}", self._result, methods=["GET"])

    async def _upload(self, request: Request) -> Response:
        try:
            await self.uploads.receive(request.query_params.get("name", ""), request.stream())
        except InputError as problem:
            return PlainTextResponse(str(problem), 400)
        except OSError as problem:
            return PlainTextResponse(f"cannot be stored: {problem.strerror}", 507)
        return PlainTextResponse("stored")

    async def _result(self, request: Request) -> Response:
        folder, file = request.path_params["folder"], request.path_params["file"]
        path = self.out / folder / file
        if not (re.fullmatch(r"diagnosis_\d+", folder) and file in RESULTS and path.is_file()):
            return PlainTextResponse("there is no such result", 404)
        # A report has scripts of its own; none of them may drive the lab.
        return FileResponse(path, headers={"content-security-policy": "sandbox allow-scripts"})

    def close(self) -> None:
        """Ends the session and a diagnosis that runs, and deletes what was uploaded."""
        self.worker.stop()
        self.jobs.cancel()
        self.uploads.close()

    def page(self) -> None:
        """Builds the page for a browser."""
        rig = RigPage(self.worker, self.uploads)
        diagnosis = DiagnosisPage(self.worker, self.uploads, self.jobs)
        with ui.element("main").classes("lab"):
            with ui.element("header"):
                ui.html(f"<h1>{TITLE}</h1>", sanitize=False, tag="div")
                ui.label("Two hydraulic motors, two unequal valves, one controller.").classes("lab-soft")
            with ui.element("div"):
                rig.show_rig()
            with ui.element("div").classes("lab-choices"):
                rig.show_time()
                rig.show_controller()
                rig.show_valves()
                rig.show_effects()
            with ui.element("div"):
                diagnosis.show()


def application(lab: Lab | LivePage, port: int, key: str, ready: Callable[[], None] = lambda: None) -> Guard:
    """The guarded web application of a lab; `ready` is called once it is served."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        lab.start()
        asyncio.get_running_loop().call_later(0.2, ready)
        yield

    app = FastAPI(lifespan=life, docs_url=None, redoc_url=None, openapi_url=None)

    lab.add_routes(app)

    def page() -> None:
        ui.page_title(TITLE)
        ui.add_css(Path(__file__).with_name("style.css"))
        ui.colors(primary="#0b62a8")
        lab.page()

    look: dict[str, Any] = {"title": TITLE, "dark": None, "language": "en-US", "tailwind": False}
    ui.run_with(app, root=page, show_welcome_message=False, **look)
    return Guard(app, port, key)


def run(
    out: Path, settings: Settings | None = None, *, live: Path | None = None, port: int = 8137, browser: bool = True
) -> None:  # fmt: skip
    """Serves the page until Ctrl-C, or until the terminal or the system ends it. `settings` are what it begins with; with `live`,
    a folder of `hydro-env live`, the page follows that instead; `port` 0 takes any that is free.

    InputError if the port is taken, `out` cannot be written, or the settings or `live` name what is not there.
    """
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not (there.is_dir() and os.access(there, os.W_OK)):
        raise InputError(f"--out {out}: cannot write there; name a folder that can be written")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((HOST, port))
        except OSError as problem:
            told = f"cannot be used ({problem.strerror}); name another one"
            raise InputError(f"--port {port}: {told}") from None
        port, key = listener.getsockname()[1], secrets.token_urlsafe(16)
        address = f"http://{HOST}:{port}/?key={key}"

        def ready() -> None:
            print(f"{TITLE}: {address}\nCtrl-C ends it. {lab.told}", flush=True)
            if browser:
                webbrowser.open(address)

        lab = Lab(out, Session(settings)) if live is None else LivePage(live)
        served: Any = application(lab, port, key, ready)
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.default_int_handler)
        # What the server itself would say of a second Ctrl-C is of no use to anybody.
        config = uvicorn.Config(served, log_level="critical", timeout_graceful_shutdown=2)
        try:
            with suppress(KeyboardInterrupt):
                uvicorn.Server(config).run(sockets=[listener])
        finally:
            lab.close()
