"""`twin run --live`: a page in which the scene's probe is moved by hand, with picture and forces.

A question holds the probe's place and load; the reply is a short table in JSON and the CCD picture.
Every question is a press of its own from first touch, in one step (`twin.study.environment`). One
with ``seconds`` follows those before it at the same place: the rubber relaxes, and patches remember
where they slipped.

The page is served on the loopback address only; requests without the token are refused, and so are
pages of another name that points at this machine (DNS rebinding) and other sites' scripts. Why not
a framework: one page and one question need no more than the standard library. Why replies are
computed by the thread that called `serve`, one at a time: numeric libraries are not all safe to
call from several threads, and Ctrl-C reaches that thread.
"""

from __future__ import annotations

import hmac
import json
import math
import queue
import secrets
import struct
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from twin.arrays import Bools, Progress, eight_bits
from twin.errors import ContactError, InputError, RecipeError, TwinError
from twin.files import plain
from twin.parts.press import Press, Step
from twin.parts.scene import Scene
from twin.study.environment import Environment, Observation
from twin.world.contact.contact_state import MEASURED

QUICK = {
    "accuracy.contact_patches": 8,
    "accuracy.contact_increments": 4,
    "accuracy.centroid_px": 0.05,
    "accuracy.surface_table": True,
}
"""What a live scene is overridden with before anything the user asks for: marker displacements
change by up to 0.8 % of the largest (measured against 16 patches in 8 parts), centroids by up to
0.03 px, for a third of the time on a block; on a curved body for a twentieth, after half a minute
or so for the table of its surface, which is kept."""

MOST_STEPS = 300
"""Steps of a press in time, which is then begun again: each update solves all of them."""

FRICTIONS = (0.0, 0.3, 0.6, 1.2, math.inf)


@dataclass(frozen=True, kw_only=True)
class Hand:
    """Where the probe is and how it is loaded.

    Attributes
    ----------
    at_mm, push_n
        (x, y) of the probe, and the force along z; none lifts the probe.
    side, twist
        (x, y) and about z, along the axes of the scene's press: forces in N and torque in N mm, or
        with `by_motion` the probe's motion in mm and degrees while it pushes.
    by_motion
        Held by motion: on a slope a probe that is held by forces alone slides off.
    friction
        0, without which neither side force nor torque is carried, up to inf, which sticks.
    """

    at_mm: tuple[float, float]
    push_n: float
    side: tuple[float, float]
    twist: float
    friction: float
    by_motion: bool

    @classmethod
    def of(cls, question: Mapping[str, Any], *, by_motion: bool) -> Hand:
        """Read a question, or raise `InputError` for what is no number or out of range."""
        sticks = question.get("friction") == "inf"
        friction = math.inf if sticks else _number(question, "friction", 100, "")
        if friction < 0:
            raise InputError(
                f"friction = {friction:g}: allowed are 0 to 100, or 'inf' for sticking"
            )
        most, unit = (10, "mm") if by_motion else (1e3, "N")
        turn, turn_unit = (45, "degrees") if by_motion else (1e4, "N mm")
        return cls(
            at_mm=(_number(question, "x_mm", 1e3, "mm"), _number(question, "y_mm", 1e3, "mm")),
            push_n=_number(question, "push_n", 1e3, "N"),
            side=(_number(question, "side_x", most, unit), _number(question, "side_y", most, unit)),
            twist=_number(question, "twist", turn, turn_unit),
            friction=friction,
            by_motion=by_motion,
        )

    def question(self) -> dict[str, Any]:
        """Return it as a question."""
        return {
            "x_mm": self.at_mm[0],
            "y_mm": self.at_mm[1],
            "push_n": self.push_n,
            "side_x": self.side[0],
            "side_y": self.side[1],
            "twist": self.twist,
            "friction": "inf" if math.isinf(self.friction) else self.friction,
        }

    def step(self, before: Hand | None = None) -> Step:
        """Return the path's one step, or the one after a hand ``before``; `InputError` where no
        friction carries a side force."""
        (x, y), push, twist = self.side, self.push_n, self.twist
        if push <= 0.0:
            return Step(force_n=(None, None, 0.0))
        if self.friction == 0.0:
            if x or y or self.twist:
                raise InputError(
                    "a frictionless probe can't be pushed sideways or twisted: set friction above "
                    "0, or side_x, side_y and twist to 0"
                )
            return Step(force_n=(None, None, push))
        if self.by_motion:
            if before is not None:  # motion counts from there
                x, y, twist = x - before.side[0], y - before.side[1], twist - before.twist
            return Step(force_n=(None, None, push), move_mm=(x, y, None), turn_deg=twist)
        return Step(force_n=(x, y, push), torque_nmm=self.twist or None)

    def press(self, scene: Press) -> Press | None:
        """Return the press: the scene's probe at our place and load; None where nothing pushes."""
        if self.push_n <= 0.0:
            return None
        return Press(
            probe=scene.probe,
            at_mm=self.at_mm,
            direction=scene.direction,
            tilt_deg=scene.tilt_deg,
            axes="global" if scene.direction is None else "probe",
            friction=self.friction,
            steps=(self.step(),),
        )


def _number(table: Mapping[str, Any], key: str, most: float, unit: str) -> float:
    value = table.get(key, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise InputError(
            f"{key} = {value!r}: allowed are numbers from {-most:g} to {most:g} {unit}".rstrip()
        )
    return float(value)


class LivePress:
    """A scene under a hand, which moves its probe; `RecipeError` where it lacks a table for it."""

    def __init__(self, scene: Scene, progress: Progress | None = None) -> None:
        self.environment = Environment(scene, progress)
        if scene.press is None:
            raise RecipeError(
                "this scene has no [press] table: --live moves the scene's probe, so give it one"
            )
        self.scene, self.moved = scene, scene.press
        self.rest = self.environment.reset()
        self._first: Press | None = None
        self._before: Hand | None = None
        self._steps = 0
        self._time_s = 0.0

    def start(self) -> Hand:
        """Return where the hand begins: the scene's place, push and friction."""
        x, y = self.moved.at_mm[:2]
        return Hand(
            at_mm=(x, y),
            push_n=self.moved.path[0].force_n[2] or 1.0,
            side=(0.0, 0.0),
            twist=0.0,
            friction=self.moved.friction,
            by_motion=not self.scene.body.is_flat,
        )

    def facts(self) -> dict[str, Any]:
        """Return what the page must know once: sites, markers at rest, ranges of sliders."""
        scene = self.scene
        begin = self.start()
        camera, _ = scene.imaging
        grid = scene.inverse.sites
        push = begin.push_n
        half = np.array(grid.half_mm) + grid.pitch_mm / 2
        side, twist = (0.3, 5.0) if begin.by_motion else (_round(push), _round(push))
        sensor = self.environment.sensor
        return {
            "title": scene.title or "Tactile sensor",
            "width": camera.width_px,
            "height": camera.height_px,
            "columns": grid.columns,
            "rows": grid.rows,
            "pitch": grid.pitch_mm,
            "site": np.round(grid.chart(), 4).tolist(),
            "marker": np.round(sensor.project(sensor.actual.markers.points), 2).tolist(),
            "layer": [list(scene.markers).index(str(name)) for name in sensor.actual.markers.layer],
            "layers": list(scene.markers),
            "probe": self.moved.probe.kind,
            "start": begin.question(),
            "side": ["move", "mm", "turn", "°"]
            if begin.by_motion
            else ["force", "N", "twist", "N mm"],
            "range": {
                "x_mm": [-half[0], half[0]],
                "y_mm": [-half[1], half[1]],
                "push_n": [0.0, _round(2 * push)],
                "side_x": [-side, side],
                "side_y": [-side, side],
                "twist": [-twist, twist],
            },
            "friction": [
                "inf" if math.isinf(mu) else mu for mu in sorted({*FRICTIONS, begin.friction})
            ],
            "note": "The first of the scene's probes is moved alone." if self.moved.also else "",
        }

    def answer(self, question: Mapping[str, Any]) -> bytes:
        """Return what the sensor sees and feels: the table's length (4 bytes, little-endian), the
        table, the picture; `InputError` or `ContactError` where there is none.
        """
        hand = Hand.of(question, by_motion=not self.scene.body.is_flat)
        started = time.perf_counter()
        seconds = None
        if question.get("seconds") is not None:
            seconds = max(_number(question, "seconds", 1e4, "s"), 0.0)
        before = self._before_of(hand, seconds)
        try:
            press = hand.press(self.moved)
            if before is not None and self._first is not None:
                press = self._first.model_copy(update={"steps": (hand.step(before),)})
        except ValueError as problem:  # the scene's probe comes in a way that can't be loaded so
            raise InputError(f"press: {problem}") from None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what they say is in the table
                seen = self.environment.step(press, seconds if press is not None else None)
        except ContactError as problem:
            raise ContactError(str(problem).removeprefix("press: ")) from None
        if press is not None and seconds is not None:
            self._first, self._before = self._first or press, hand
            self._steps += 1
            self._time_s += seconds
        measured = press if seconds is None and question.get("measured") is True else None
        table = self._table(hand, seen, measured) | {"time_s": self._time_s}
        table |= {"milliseconds": 1e3 * (time.perf_counter() - started)}
        text = json.dumps(plain(table), allow_nan=False).encode()
        return struct.pack("<I", len(text)) + text + eight_bits(seen.picture).tobytes()

    def served(self, page: str, port: int = 0) -> _Loopback:
        """Return a page (HTML) on the loopback address, which replies by `answer`; port 0 is any
        that is free. `InputError` where the port can't be had."""
        return _Loopback(page, self.answer, port)

    def _before_of(self, hand: Hand, seconds: float | None) -> Hand | None:
        """Return the hand that one follows in time; None where a press begins."""
        before = self._before
        if (
            seconds is not None
            and before is not None
            and self._steps < MOST_STEPS
            and (before.at_mm, before.friction) == (hand.at_mm, hand.friction)
        ):
            return before
        if before is not None:
            self.environment.step(None)
        self._first = self._before = None
        self._steps = 0
        self._time_s = 0.0
        return None

    def _table(self, hand: Hand, seen: Observation, measured: Press | None) -> dict[str, Any]:
        """Return the reply's table; what linear theory leaves out of a ``measured`` press is
        measured, as `twin run` does."""
        truth = seen.truth
        known: Bools = np.asarray(np.isfinite(seen.marker_shift_px).all(axis=1))
        off = (seen.marker_shift_px - truth.marker_shift_px)[known]
        state = truth.state
        contact = None
        # At finite strain the error takes as long as the press.
        slow = measured is None and state is not None and state.load.strained is not None
        if state is not None and len(state.pressure_mpa):
            sensor = self.environment.sensor
            centres = sensor.rectangles(state.load).centre_mm
            weights = state.pressure_mpa
            middle = np.average(centres, axis=0, weights=np.maximum(weights, 0) + 1e-12)
            validity = state.validity if measured is None else sensor.validity(state, measured)
            basis = validity.linearisation_basis
            asked = measured is not None and validity.notes and basis != MEASURED
            told = (f"what linear theory costs is {basis}",) if asked else ()
            contact = {
                "place": sensor.actual.scene.body.chart_of(middle[None])[0],
                "radius_mm": state.contact_radius_mm,
                "indentation_mm": state.indentation_mm,
                "peak_pressure_mpa": state.peak_pressure_mpa,
                "slip": float(np.mean(state.slip)) if state.friction else None,
                "warnings": validity.warnings,
                "notes": (*validity.notes, *told),
            }
        return {
            "hand": hand.question(),
            "shift": np.round(np.where(known[:, None], seen.marker_shift_px, 0.0), 3),
            "known": known.astype(int),
            "true": np.round(truth.force_n, 6),
            "found": np.round(seen.force_n, 6),
            "true_total": [*truth.total_force_n, truth.total_torque_nmm[2]],
            "found_total": [*seen.total_force_n, seen.total_torque_nmm[2]],
            "error": {
                **seen.error,
                "displacement": None if slow else truth.displacement_error,
                "tracking_px": float(np.sqrt(np.mean(off**2))) if len(off) else None,
            },
            "matched": float(known.mean()),
            "contact": contact,
        }


def _round(value: float) -> float:
    """Return the value to one digit, upwards."""
    digit = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / digit - 1e-9) * digit


def run_live(scene: Scene, port: int = 0, progress: Progress | None = None) -> None:
    """Serve a scene's live page until Ctrl-C; print its address."""
    from twin.blas_threads import one_thread
    from twin.show.body_view import BodyView

    _listening(port).server_close()  # a port that can't be had is refused before the work
    with one_thread():  # the steps' small products lose more than they gain by a second thread
        live = LivePress(scene, progress)
        live.answer(live.start().question())
        page = live.served(BodyView.hand_page(live.facts()), port)
        if progress is not None:
            progress("done", 1.0)
        print(f"open {page.address}\nCtrl-C ends it", flush=True)
        try:
            page.serve()
        except KeyboardInterrupt:
            print("closed", flush=True)


HOST = "127.0.0.1"
LARGEST_QUESTION = 4096
"""Bytes of the largest question that is read."""

IDLE_S = 30.0
"""An idle connection is closed after this time."""

GUARD = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src "
    "'self'; img-src data:"
)

Answer = Callable[[dict[str, Any]], bytes]
_Job = tuple[dict[str, Any], "queue.SimpleQueue[tuple[int, str, bytes]]"]


def _listening(port: int) -> _Server:
    if not 0 <= port <= 65535:
        raise InputError(
            f"--port {port}: allowed are whole numbers from 1 to 65535, and 0 for any that is free"
        )
    try:
        return _Server((HOST, port), _Handler)
    except OSError as problem:
        raise InputError(
            f"--port {port}: can't be listened on ({problem.strerror}); give another"
        ) from None


class _Loopback:
    """Serves one page (HTML) at ``/``, and replies to questions at ``/ask``.

    ``answer`` turns a question (a JSON object) into the bytes of the reply; a `TwinError` is sent
    as a problem. Port 0 is any that is free.
    """

    def __init__(self, page: str, answer: Answer, port: int = 0) -> None:
        self._answer = answer
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self.token = secrets.token_urlsafe(24)
        self._server = _listening(port)
        self._server.page = page.encode()
        self._server.token = self.token
        self._server.jobs = self._jobs

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def serve(self) -> None:
        """Answer until interrupted."""
        listener = threading.Thread(
            target=self._server.serve_forever, name="twin-loopback", daemon=True
        )
        listener.start()
        try:
            while True:
                question, reply = self._jobs.get()
                try:
                    reply.put((200, "application/octet-stream", self._answer(question)))
                except TwinError as problem:
                    text = json.dumps({"problem": str(problem)}).encode()
                    reply.put((422, "application/json", text))
        finally:
            self._server.shutdown()
            self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = False
    page: bytes
    token: str
    jobs: queue.SimpleQueue[_Job]

    def handle_error(self, *_: object) -> None:
        """Say nothing of a browser that went away."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = IDLE_S
    server: _Server

    def do_GET(self) -> None:
        if self._refused():
            return
        if urlsplit(self.path).path != "/":
            self._send(404, "text/plain", b"no such page\n")
            return
        self._send(200, "text/html; charset=utf-8", self.server.page)

    def do_POST(self) -> None:
        if self._refused():
            return
        if urlsplit(self.path).path != "/ask":
            self._send(404, "text/plain", b"no such page\n", close=True)
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > LARGEST_QUESTION:
            text = f"a question needs a Content-Length of up to {LARGEST_QUESTION} bytes\n".encode()
            self._send(413, "text/plain", text, close=True)
            return
        try:
            question = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            question = None
        if not isinstance(question, dict):
            self._send(400, "text/plain", b"a question is a JSON object\n", close=True)
            return
        reply: queue.SimpleQueue[tuple[int, str, bytes]] = queue.SimpleQueue()
        self.server.jobs.put((question, reply))
        self._send(*reply.get())

    def _refused(self) -> bool:
        """Refuse who doesn't hold the token, and pages that are not ours."""
        given = parse_qs(urlsplit(self.path).query).get("token", [""])[0]
        ours = {f"{name}:{self.server.server_address[1]}" for name in (HOST, "localhost")}
        origin = self.headers.get("Origin")
        if (
            hmac.compare_digest(given.encode(), self.server.token.encode())
            and self.headers.get("Host") in ours
            and (origin is None or origin.removeprefix("http://") in ours)
        ):
            return False
        text = b"refused: open the address that twin printed, with its token\n"
        self._send(403, "text/plain", text, close=True)
        return True

    def _send(self, code: int, kind: str, body: bytes, *, close: bool = False) -> None:
        self.send_response(code)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("Content-Security-Policy", GUARD),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
        ):
            self.send_header(name, value)
        if close:
            self.send_header("Connection", "close")
            self.close_connection = True
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Name no versions."""
        return "twin"

    def log_message(self, *_: object) -> None:
        """Print nothing: the address with its token must not end in a log."""
