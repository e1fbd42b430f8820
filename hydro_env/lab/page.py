"""The page of the rig: what it shows, and what may be chosen. What that does stands in `session` and `worker`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from html import escape
from itertools import groupby
from math import floor, log10
from typing import Any

from nicegui import ui

from hydro_env.controllers import CONTROLLERS
from hydro_env.lab.adjust import Slider, effects_by_port, sliders
from hydro_env.lab.elements import Motors, Plots, SlidingNumber, quiet_button
from hydro_env.lab.session import MANUAL, Session
from hydro_env.lab.uploads import Uploads
from hydro_env.lab.worker import Seen, Worker
from hydro_env.plant.catalogue import Effect
from hydro_env.tasks import NAMED_PAIRS, OWN, SCENARIOS, SPLITS, default_mismatch

#: Seconds between two pictures, and between two sentences for a screen reader.
PICTURE, SENTENCE = 0.1, 5.0
#: Speeds of time that may be chosen.
TEMPOS = {0.1: "0.1 ×", 0.25: "0.25 ×", 0.5: "0.5 ×", 1.0: "real time", 2.0: "2 ×", 5.0: "5 ×"}


@contextmanager
def section(title: str) -> Iterator[None]:
    """A part of the page with a heading."""
    with ui.element("section").props(f'aria-label="{title}"'):
        ui.html(f"<h2>{escape(title)}</h2>", sanitize=False, tag="div")
        yield


def _short(value: float) -> str:
    """Three digits."""
    return f"{float(f'{value:.3g}'):g}"


def _status(seen: Seen) -> str:
    """Time, speed of time, loads and the log that is being recorded."""
    session = seen.session
    going = f"{seen.reached:.2g} × real time" if seen.running else "paused"
    log = "" if session.recorded is None else f", recording: {session.recorded:.0f} s"
    loads = " and ".join(f"{load:.2f}" for load in session.load_Nm)
    return f"{session.time:.1f} s, {going}; loads {loads} N m{log}"


class RigPage:
    """What one browser sees of the rig; all browsers see the same rig."""

    def __init__(self, worker: Worker, uploads: Uploads) -> None:
        self._worker, self._uploads = worker, uploads
        self._ask = worker.ask
        self._ports: list[tuple[ui.expansion, list[Effect]]] = []
        self._shown_preset = worker.seen.session.settings.preset
        self._effects: list[tuple[Slider, SlidingNumber]] = []
        self._followed: list[Callable[[Seen], None]] = []

    def _says(self, element: Any, text: Callable[[Seen], str]) -> Any:
        """An element whose text follows the newest state."""
        return element.bind_text_from(self._worker, "seen", text)

    def _follow(self, element: Any, choice: Callable[[Seen], Any]) -> None:
        """Lets an element take over a choice of the session when that changes, as another browser may have made it."""
        last = choice(self._worker.seen)

        def follow(seen: Seen) -> None:
            nonlocal last
            if (now := choice(seen)) != last:
                last = element.value = now

        self._followed.append(follow)

    def _select(self, names: Any, label: str, field: str, change: Callable[[Session, Any], None]) -> Any:
        """A field of the session's settings; `change` makes what the user takes."""

        def chosen(event: Any) -> None:
            if event.value != getattr(self._worker.seen.session.settings, field):
                self._ask(lambda session: change(session, event.value))

        now = getattr(self._worker.seen.session.settings, field)
        element = ui.select(names, value=now, label=label, on_change=chosen).classes("w-full")
        self._follow(element, lambda seen: getattr(seen.session.settings, field))
        return element

    # --- what is seen ---------------------------------------------------------------------------------------------
    def show_rig(self) -> None:
        """Motors, plots, and what is to be said."""
        with section("Rig"):
            self._motors = Motors()
            problem = ui.label().classes("lab-bad").props("role=alert")
            self._says(problem, lambda seen: seen.refused or seen.session.problem)
            self._sentence = ui.label().classes("lab-quiet").props('role=status aria-live="polite"')
        with section("Last ten seconds"):
            self._plots = Plots()
        ui.timer(PICTURE, self._refresh)
        ui.timer(SENTENCE, self._speak)

    def _refresh(self) -> None:
        seen = self._worker.seen
        self._motors.show(seen)
        self._plots.show(seen)
        self._follow_rig(seen.session.settings.preset)
        for follow in self._followed:
            follow(seen)

    def _speak(self) -> None:
        seen, now = self._worker.seen, self._worker.seen.session.now
        if seen.running:
            speeds = f"motor 1 {now['speed_1_rpm']:.0f}, motor 2 {now['speed_2_rpm']:.0f} rpm"
            said = f"difference {now['difference_rpm']:.0f} rpm, {speeds}"
            self._sentence.text = said if self._aloud.value else ""

    def _follow_rig(self, preset: str) -> None:
        """Offers the rigs that there are, and after another one was chosen the sliders that suit it."""
        rigs = self._uploads.rigs(preset)
        if rigs != self._preset.options:
            self._preset.set_options(rigs, value=preset)
        if preset != self._shown_preset:
            self._shown_preset = preset
            self._show_hand()
            self._effects.clear()
            for part, effects in self._ports:
                part.clear()
                self._fill(part, effects)

    # --- what may be chosen ---------------------------------------------------------------------------------------
    def show_time(self) -> None:
        """Pause, reset, speed of time."""
        with section("Time"):
            with ui.element("div").classes("lab-row"):
                pause = ui.button(on_click=lambda: self._worker.pause(self._worker.seen.running))
                self._says(pause, lambda seen: "Pause" if seen.running else "Go on")
                quiet_button("Reset", lambda: self._ask(Session.reset))
                tempo = ui.select(TEMPOS, value=self._worker.seen.tempo, label="speed of time")
                tempo.on_value_change(lambda event: self._worker.set_tempo(event.value))
                self._follow(tempo.classes("w-full"), lambda seen: seen.tempo)
            self._says(ui.label().classes("lab-soft"), _status)
            self._aloud = ui.checkbox("say the difference to a screen reader every 5 s", value=True)

    def show_controller(self) -> None:
        """The controller, and what drives it."""
        chosen = self._worker.seen.session.settings.controller
        names = {chosen: chosen} | {name: name for name in CONTROLLERS}
        with section("Controller"):
            self._select(names, "controller", "controller", Session.choose_controller)
            about = {name: each.summary for name, each in CONTROLLERS.items()}
            self._says(ui.label(), lambda seen: about.get(seen.session.settings.controller, ""))
            self._says(ui.label().classes("lab-soft"), lambda seen: seen.session.note)
        names = {name: f"{name}: {each.summary}" for name, each in SCENARIOS.items()}
        with section("Scenario"):
            self._select({MANUAL: "by hand"} | names, "set-point", "scenario", Session.choose_scenario)
            self._hand = ui.element("div").classes("w-full")
            self._show_hand()

    def _show_hand(self) -> None:
        """What is set by hand: as far as the rig goes."""
        session = self._worker.seen.session
        settings, reach = session.settings, session.reach
        self._hand.clear()
        with self._hand:
            most = f"{_short(reach.speed_rpm)} rpm without load, {_short(reach.torque_Nm)} N\u00a0m at standstill"
            rated = " and ".join(f"{each:g}" for each in dict.fromkeys(reach.rated_V))
            ui.label(f"The rig reaches {most}, with {rated} V at the valves.").classes("lab-soft")
            self._by_hand(
                "set-point by hand", reach.speed_rpm, settings.setpoint_rpm, "rpm", Session.set_setpoint
            )
            with ui.element("div").classes("lab-pair"):
                for channel, load in enumerate(settings.load_Nm):
                    self._by_hand(
                        f"load on motor {channel + 1}", reach.torque_Nm, load, "N m",
                        lambda session, torque, channel=channel: session.set_load(channel, torque),
                    )  # fmt: skip

    def _by_hand(self, label: str, most: float, now: float, unit: str, change: Callable[..., None]) -> None:
        """A slider from `-most` to `most` in round steps."""
        step = 10.0 ** floor(log10(most / 50.0))  # 1, 10, 100, 0.1 ...: 50 to 500 of them to an end
        ends = floor(most / step)

        def value(position: int) -> float:
            return round(position * step, 9)

        SlidingNumber(
            label, (-ends, ends), round(now / step), lambda position: f"{value(position):g} {unit}",
            lambda position: self._ask(lambda session: change(session, value(position))),
        )  # fmt: skip

    def show_valves(self) -> None:
        """Rig, split and number of the pair."""
        settings = self._worker.seen.session.settings
        splits = {OWN: "own: the rig's pair"} | {name: name for name in (*SPLITS, *NAMED_PAIRS)}

        def choose(session: Session, **changes: Any) -> None:
            now = replace(session.settings, **changes)
            session.choose_valves(now.preset, now.split, now.number)

        def choose_preset(session: Session, preset: str) -> None:
            # A model file that has valves of its own is driven with them.
            choose(session, preset=preset, split=default_mismatch(preset, session.settings.split))

        def choose_number(_: Any) -> None:
            now = int(number.value or 0)
            self._ask(lambda session: choose(session, number=now))

        with section("Valves"):
            rigs = self._uploads.rigs(settings.preset)
            self._preset = self._select(rigs, "preset or model", "preset", choose_preset)
            with ui.element("div").classes("lab-row"):
                self._select(
                    splits, "split of pairs", "split", lambda session, split: choose(session, split=split)
                )
                number = ui.number("number of the pair", value=settings.number, min=0, step=1, precision=0)
                number.on("change", choose_number)
                self._follow(number, lambda seen: seen.session.settings.number)

    def show_effects(self) -> None:
        """A slider for every parameter of every effect, by port; a port's sliders are made when it is opened."""
        with section("Effects"):
            ui.label("What a real rig does beyond the equations. A slider acts at once.").classes("lab-soft")
            quiet_button("All as they were", lambda: self._ask(Session.clear_effects))
            for port, effects in effects_by_port().items():
                part = ui.expansion(f"{port} ({len(effects)})").classes("w-full")
                part.on_value_change(partial(self._fill, part, effects))
                self._ports.append((part, effects))
        ui.timer(0.5, self._follow_effects)

    def _fill(self, part: ui.expansion, effects: list[Effect]) -> None:
        """Makes the sliders of a port that is open."""
        if not part.value or part.default_slot.children:
            return
        scales = self._worker.seen.session.reach.scales
        with part:
            for effect in effects:
                ui.html(f"<h3>{escape(effect.title)}</h3>", sanitize=False, tag="div")
                ui.label(effect.summary).classes("lab-soft")
                for name, pair in groupby(sliders(effect, scales), key=lambda slider: slider.parameter.name):
                    title = effect.parameter(name).title
                    ui.label(title)
                    with ui.element("div").classes("lab-pair"):
                        for slider in pair:
                            self._show_slider(slider, title)

    def _show_slider(self, slider: Slider, title: str) -> None:
        def moved(position: int) -> None:
            value = slider.value(position)
            self._ask(lambda session: session.set_effect(slider.name, slider.channel, value))

        now = self._value(slider)
        label = "rig" if slider.channel is None else f"channel {slider.channel + 1}"
        shown = SlidingNumber(
            label, (slider.lowest, slider.highest), slider.position(now),
            lambda position: slider.text(slider.value(position)), moved, title,
        )  # fmt: skip
        shown.say(slider.text(now))
        self._effects.append((slider, shown))

    def _value(self, slider: Slider) -> float:
        return self._worker.seen.session.effects[slider.name][slider.channel or 0]

    def _follow_effects(self) -> None:
        """Places the sliders again where a value is not the one that was set here: after a reset, or from another browser."""
        for slider, shown in self._effects:
            now = self._value(slider)
            if shown.at_rest and shown.props["text"] != slider.text(now):
                shown.place(slider.position(now), slider.text(now))
