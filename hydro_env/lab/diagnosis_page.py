"""The part of the page for logs: record one, drop some in, look at them, diagnose them, open the report."""

from typing import Any

from nicegui import run, ui

from hydro_env.errors import InputError
from hydro_env.lab.elements import Drop, quiet_button
from hydro_env.lab.jobs import Jobs
from hydro_env.lab.page import section
from hydro_env.lab.session import Session
from hydro_env.lab.uploads import Upload, Uploads
from hydro_env.lab.worker import Worker

#: Seconds between two looks at the diagnosis.
LOOK = 0.3
ROLES = {"fit": "to fit", "held_out": "held out", "": "not used"}
LABEL = "Logs (CSV, Parquet, MAT, MDF4, TDMS), mapping or model (YAML): drop files here, or choose"


class DiagnosisPage:
    """What one browser sees of the logs and of the diagnosis; all browsers see the same."""

    def __init__(self, worker: Worker, uploads: Uploads, jobs: Jobs) -> None:
        self._worker, self._uploads, self._jobs = worker, uploads, jobs
        self._listed: list[Upload] = []
        self._shown: Any = None

    def show(self) -> None:
        """Builds the part."""
        preset, jobs = self._worker.seen.session.settings.preset, self._jobs
        with section("Log and diagnosis"):
            record = quiet_button("", self._toggle_recording)
            words = {True: "Record a log, from rest", False: "Stop recording"}
            record.bind_text_from(self._worker, "seen", lambda seen: words[seen.session.recorded is None])
            Drop(LABEL, self._list, lambda text: self._problem.set_text(text.removeprefix("hydro-env lab: ")))
            self._files = ui.element("div").classes("w-full")
            ui.label("With no log held out, the last third of the last log is.").classes("lab-soft")
            self._model = ui.select(self._uploads.rigs(preset), value=preset, label="model to diagnose")
            self._model.classes("w-full")
            with ui.element("div").classes("lab-row"):
                for start in (
                    ui.button("Diagnose", on_click=lambda: self._begin("diagnose")),
                    quiet_button("Look at the log", lambda: self._begin("inspect")),
                ):
                    start.bind_enabled_from(jobs, "running", lambda running: not running)
                cancel = quiet_button("Cancel", lambda: run.io_bound(jobs.cancel))
                cancel.bind_enabled_from(jobs, "running")
            self._problem = ui.label().classes("lab-bad").props("role=alert")
            self._progress = ui.linear_progress(0.0, show_value=False)
            self._progress.props('aria-label="progress of the diagnosis"')
            self._progress.bind_visibility_from(jobs, "running")
            self._stage = ui.label().props('role=status aria-live="polite"')
            self._results = ui.element("div").classes("w-full")
        ui.timer(LOOK, self._refresh)

    # --- files ----------------------------------------------------------------------------------------------------
    def _toggle_recording(self) -> None:
        idle = self._worker.seen.session.recorded is None
        self._worker.ask(Session.record if idle else Session.stop_recording)

    def _list(self) -> None:
        """Lists the files again; a model that has come is the one to diagnose, and one that has gone no longer is."""
        new = [
            str(each.path)
            for each in self._uploads.files
            if each.role == "model" and each not in self._listed
        ]
        self._listed = [*self._uploads.files]
        rigs = self._uploads.rigs(self._worker.seen.session.settings.preset)
        kept = self._model.value if self._model.value in rigs else next(iter(rigs))
        self._model.set_options(rigs, value=new[-1] if new else kept)
        self._files.clear()
        with self._files:
            for upload in self._uploads.files:
                self._list_one(upload)

    def _list_one(self, upload: Upload) -> None:
        def remove() -> None:
            self._uploads.remove(upload)
            self._list()

        with ui.element("div").classes("lab-file"):
            with ui.element("span"):
                ui.label(upload.name)
            if upload.role in ROLES:
                use = ui.select(ROLES).bind_value(upload, "role")
                use.props["aria-label"] = f"use of {upload.name}"
            else:
                ui.label(upload.role)
            quiet_button("Remove", remove, f"remove {upload.name}")

    # --- the diagnosis --------------------------------------------------------------------------------------------
    def _begin(self, what: str) -> None:
        self._problem.text = ""
        fit, held_out, mappings = map(self._uploads.with_role, ("fit", "held_out", "mapping"))
        try:
            if not fit:
                raise InputError("no log to fit; drop one in, or record one")
            mapping = mappings[-1] if mappings else None
            self._jobs.start(what, fit, held_out, str(self._model.value), mapping)
        except InputError as problem:
            self._problem.text = str(problem)

    def _refresh(self) -> None:
        if self._uploads.files != self._listed:
            self._list()
        job = self._jobs.latest
        if job is None or job is self._shown:
            return
        self._shown = job
        self._progress.value = job.share
        count = f", {job.simulations} simulations" if job.simulations else ""
        self._stage.text = f"{job.stage}{count}"
        if job.state == "failed":
            self._problem.text = job.problem
        self._results.clear()
        with self._results:
            for text in job.warnings:
                ui.label(f"warning: {text}")
            if job.state == "done" and job.result is not None:
                self._show_result(job.folder, job.result)

    def _show_result(self, folder: str, result: Any) -> None:
        if "verdict" in result:
            ui.label(f"Verdict: {result['verdict']}.").style("font-weight: 600")
            ui.link("Open the report", f"/results/{folder}/report.html", new_tab=True)
            ui.label(f"Written to {folder} in --out.").classes("lab-soft")
            _text(result["summary"])
            return
        _text(result["text"])
        if result["mapping"]:
            ui.label("Proposed mapping; correct what is wrong, then use it:")
            text = ui.textarea(value=result["mapping"]).props('aria-label="mapping" outlined')
            text.classes("w-full")
            quiet_button("Use this mapping", lambda: self._use_mapping(text.value))

    def _use_mapping(self, text: str) -> None:
        for upload in [each for each in self._uploads.files if each.role == "mapping"]:
            self._uploads.remove(upload)
        self._uploads.store("mapping.yaml", text, "mapping.yaml (from this page)", "mapping")


def _text(text: str) -> None:
    """Text as a terminal shows it."""
    with ui.element("pre").props("tabindex=0"):
        ui.label(text)
