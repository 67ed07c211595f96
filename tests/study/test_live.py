"""The live page: who may ask, what a step over HTTP changes, and that a real browser shows it."""

import http.client
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from twin.errors import InputError
from twin.show.body_view import BodyView
from twin.study.live import LARGEST_QUESTION, QUICK, Hand, LivePress, run_live

PUSH = {"x_mm": 1.0, "y_mm": -0.5, "push_n": 2.0, "side_x": 0.2, "side_y": 0.0, "twist": 0.5, "friction": 1.2}


@pytest.fixture(scope="module")
def live() -> LivePress:
    return LivePress(twin.load_scene("kamiyama_pillar", QUICK))


@pytest.fixture(scope="module")
def page(live: LivePress) -> Iterator[Any]:
    page = live.served("<p>the page</p>")
    threading.Thread(target=page.serve, daemon=True).start()
    return page


def asked(page, method, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60)
    try:
        connection.request(method, path, body, {key.replace("_", "-"): value for key, value in headers.items()})
        reply = connection.getresponse()
        return reply.status, reply.read(), dict(reply.getheaders())
    finally:
        connection.close()


def step(page: Any, hand: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray]:
    status, body, _ = asked(page, "POST", f"/ask?token={page.token}", json.dumps(hand).encode())
    assert status == 200, body
    (size,) = struct.unpack("<I", body[:4])
    return json.loads(body[4 : 4 + size]), np.frombuffer(body[4 + size :], np.uint8).reshape(480, 640, 3)


def test_without_the_token_everything_is_refused(page: Any) -> None:
    tokens = ("", "wrong", page.token[:-1], "%ff%fe")
    for path in ("/", "/ask", "/favicon.ico", *(f"/?token={token}" for token in tokens)):
        for method in ("GET", "POST"):
            status, body, _ = asked(page, method, path, b"{}" if method == "POST" else None)
            assert status == 403, (method, path)
            assert page.token.encode() not in body
            assert b"the page" not in body


def test_with_it_the_page_comes_with_its_guard(page: Any) -> None:
    status, body, headers = asked(page, "GET", f"/?token={page.token}")
    assert (status, body) == (200, b"<p>the page</p>")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Cache-Control"] == "no-store"
    assert asked(page, "GET", f"/other?token={page.token}")[0] == 404


def test_another_name_or_another_site_is_refused_even_with_the_token(page: Any) -> None:
    path = f"/?token={page.token}"
    assert asked(page, "GET", path, Host="evil.example")[0] == 403
    assert asked(page, "POST", f"/ask?token={page.token}", b"{}", Origin="http://evil.example")[0] == 403
    assert asked(page, "GET", path, Host=f"localhost:{page.port}")[0] == 200


def test_it_listens_on_loopback_alone(page: Any) -> None:
    assert page.address.startswith("http://127.0.0.1:")
    with pytest.raises(OSError, match=r"refused|unreachable|timed out"):  # any other address of loopback
        socket.create_connection(("127.0.0.2", page.port), timeout=2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # our address towards the world: nothing is sent
        try:
            probe.connect(("192.0.2.1", 9))
            own = probe.getsockname()[0]
        except OSError:
            pytest.skip("this machine has no other address")
    if own.startswith("127."):
        pytest.skip("this machine has no other address")
    with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
        socket.create_connection((own, page.port), timeout=2)


def test_a_step_changes_the_picture_and_tells_the_forces(page: Any) -> None:
    lifted, rest = step(page, {**PUSH, "push_n": 0.0})
    told, pressed = step(page, PUSH)
    assert lifted["contact"] is None
    assert (np.abs(pressed.astype(int) - rest) > 40).sum() > 1000
    assert told["true_total"][:3] == pytest.approx([0.2, 0.0, 2.0], abs=1e-5)
    assert told["found_total"][:3] == pytest.approx([0.2, 0.0, 2.0], abs=0.12)
    assert told["error"]["total_force_error"] < 0.06
    assert np.sum(told["true"], axis=0)[2] == pytest.approx(2.0, abs=1e-3)
    assert told["contact"]["place"] == pytest.approx([1.0, -0.5], abs=0.1)


def test_what_can_t_be_is_said_and_the_page_lives_on(page: Any) -> None:
    path = f"/ask?token={page.token}"
    for question, said in (
        ({**PUSH, "x_mm": 49.5}, b"edge"),
        ({**PUSH, "side_x": 100.0}, b"100 N sideways at 2 N"),
        ({**PUSH, "push_n": "much"}, b"push_n = 'much': allowed are numbers"),
        ({**PUSH, "push_n": 1e9}, b"push_n"),
        ({**PUSH, "friction": -1}, b"friction = -1: allowed"),
    ):
        status, body, _ = asked(page, "POST", path, json.dumps(question).encode())
        assert (status, said in body) == (422, True), body
    for body in (b"", b"[]", b"{", b'{"push_n": NaN}', b"[" * 3000, b"\xff"):
        assert asked(page, "POST", path, body)[0] in (400, 422), body
    assert asked(page, "POST", path, b" " * (LARGEST_QUESTION + 1))[0] == 413
    assert step(page, PUSH)[0]["matched"] > 0.99


def test_in_time_a_held_press_creeps_slip_stays_and_another_place_begins_anew() -> None:
    live = LivePress(twin.load_scene("gelpad_creep", QUICK))
    hand = {**live.start().question(), "friction": 0.6}

    def ask(seconds: float | None = 0.3, **change: float) -> dict[str, Any]:
        reply = live.answer({**hand, **change, "seconds": seconds})
        return json.loads(reply[4 : 4 + struct.unpack("<I", reply[:4])[0]])

    def largest(seen: dict[str, Any]) -> float:
        return float(np.abs(seen["shift"]).max())

    first, *held = [ask() for _ in range(4)]
    depths = [seen["contact"]["indentation_mm"] for seen in (first, *held)]
    assert np.all(np.diff(depths) > 0)
    assert depths[-1] > 1.04 * depths[0]
    assert held[-1]["time_s"] == pytest.approx(1.2)
    assert held[-1]["found_total"][2] == pytest.approx(0.2, abs=0.015)
    ask(side_x=0.1)
    after = ask()
    assert largest(after) > 1.02 * largest(held[-1]), "patches have slipped"
    lifted = ask(push_n=0.0)
    assert lifted["contact"] is None
    assert largest(lifted) > 0.1, "the rubber has not yet recovered"
    assert lifted["found_total"][2] == pytest.approx(0, abs=0.008)
    assert ask()["contact"] is not None, "pressed again"
    moved = ask(x_mm=hand["x_mm"] + 1.0)
    assert moved["time_s"] == pytest.approx(0.3)
    assert moved["contact"]["indentation_mm"] == pytest.approx(depths[0], rel=0.02)
    assert ask(None)["time_s"] == 0
    with pytest.raises(InputError, match="seconds = 'long'"):
        live.answer({**hand, "seconds": "long"})


def test_a_press_at_rest_states_the_measured_cost_of_linear_theory(page: Any, live: LivePress) -> None:
    """One number: what `twin run` measures under the same press, no longer the law's, eight times as large."""
    table, _ = step(page, live.start().question())
    assert "may be 7.0 % of the largest displacement off" in " ".join(table["contact"]["notes"])
    table, _ = step(page, live.start().question() | {"measured": True})
    validity = live.environment.sensor.validity(live.environment.sensor.press())
    assert f"is {100 * validity.linearisation_error:.2g} % of the largest" in table["contact"]["notes"][0]
    assert validity.linearisation_basis == "measured"
    assert "estimated" not in " ".join(table["contact"]["notes"])


def test_a_port_that_can_t_be_had_is_said_before_any_work(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.study.live.LivePress", None)
    with pytest.raises(InputError, match=f"--port {page.port}"):
        run_live(twin.load_scene("kamiyama_pillar"), page.port)
    with pytest.raises(InputError, match="65535"):
        run_live(twin.load_scene("kamiyama_pillar"), 70000)


def test_the_page_begins_with_the_scenes_friction(live: LivePress) -> None:
    assert live.start().friction == live.scene.press.friction == 0
    assert 0 in live.facts()["friction"]


def test_without_friction_the_probe_is_only_pressed_and_on_a_slope_it_is_held_by_motion() -> None:
    smooth = {**PUSH, "friction": 0, "side_x": 0, "side_y": 0, "twist": 0}
    assert Hand.of(smooth, by_motion=False).step().force_n == (None, None, 2.0)
    for sideways in ("side_x", "side_y", "twist"):
        with pytest.raises(InputError, match="frictionless"):
            Hand.of({**smooth, sideways: 0.1}, by_motion=False).step()
    slope = Hand.of(PUSH, by_motion=True).step()
    assert (slope.force_n, slope.move_mm, slope.turn_deg) == ((None, None, 2.0), (0.2, 0.0, None), 0.5)


def test_the_page_holds_no_markup_of_the_title_and_fetches_nothing(live: LivePress) -> None:
    text = BodyView.hand_page({**live.facts(), "title": "</script><b>"})
    assert "<b>" not in text
    assert text.count("</script>") == 2
    assert not re.search(r"https?://|\bsrc\s*=", text)


@pytest.fixture
def command() -> Iterator[tuple[subprocess.Popen[str], str]]:
    running = subprocess.Popen(
        [sys.executable, "-m", "twin", "run", "kamiyama_pillar", "--live"], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        yield running, running.stdout.readline().removeprefix("open ").strip()
    finally:
        running.kill()
        running.wait()


@pytest.mark.skipif(not shutil.which("chromium"), reason="needs a browser: apt install chromium")
def test_a_control_with_the_focus_keeps_its_own_keys(live: LivePress, tmp_path: Path) -> None:
    """A box is ticked by the space bar, and a slider moved by arrows, which elsewhere move the probe."""
    asked = [["time", " "], ["circle", " "], ["push_n", "ArrowRight"], ["true", "ArrowRight"], ["true", " "]]
    script = f"""<script>document.body.dataset.taken = {json.dumps(asked)}.map(([id, key]) => {{
        const pressed = new KeyboardEvent("keydown", {{key, bubbles: true, cancelable: true}});
        byId(id).dispatchEvent(pressed); return pressed.defaultPrevented; }})</script></body>"""
    page = tmp_path / "live.html"
    text = BodyView.hand_page({**live.facts(), "title": "press"})
    page.write_text(text.replace("</body>", script))
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", page.as_uri()]
    shown = subprocess.run(browser, capture_output=True, text=True, check=True).stdout
    assert 'data-taken="false,false,false,true,true"' in shown


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromium"), reason="needs a browser: apt install chromium")
def test_a_browser_shows_it_moving_and_ctrl_c_ends_it(command, tmp_path):
    running, address = command
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1400,900"]
    waits = "--virtual-time-budget=6000"
    said = subprocess.run(
        [*browser, waits, "--dump-dom", f"{address}#circle"], capture_output=True, text=True, check=True, timeout=300
    )
    assert int(re.search(r'data-painted="(\d+)"', said.stdout)[1]) > 5, "it moves in a circle"
    assert "data-problem" not in said.stdout
    assert "updates/s" in said.stdout
    picture = tmp_path / "live.png"
    subprocess.run([*browser, waits, f"--screenshot={picture}", address], capture_output=True, check=True, timeout=300)
    from PIL import Image

    shown = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    orange = (shown[..., 0] > 190) & (shown[..., 1] < 170) & (shown[..., 2] < 120)
    assert orange[100:450, 550:950].sum() > 500, "the true field"
    assert orange[100:450, 950:].sum() > 500, "the recovered field"
    assert (shown[100:450, 30:520].max(axis=2) < 60).mean() > 0.4, "the picture on its black ground"
    running.send_signal(signal.SIGINT)
    out, error = running.communicate(timeout=30)
    assert (running.returncode, "closed" in out, "Traceback" in error) == (0, True, False)
