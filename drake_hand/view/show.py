"""A plan as a page in the browser: standalone HTML, or served until interrupted."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from drake_hand.errors import InputError, NoPlanFound
from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Plan
from drake_hand.view.course import Course
from drake_hand.view.page import Page, Stop, add_panel, certificate_facts
from drake_hand.view.stage import Stage, frame_times

FIRST_PORT = 7000
INSTANT_S = 1e-4
"""Too short to be seen in the times that a page shows."""


def render(plan: Plan, scene: Scene, failure: NoPlanFound | None = None) -> Page:
    """A plan as one HTML page: hand and object, contact points and forces, mode and mode timeline, play, pause, scrub.

    Args:
        plan: what to show.
        scene: its hand and object.
        failure: of the planning that got no further; the page says it, and opens where it got stuck.
    """
    course = Course.of(plan, scene.hand, frame_times(plan.duration))
    states = course.states
    stage = Stage(scene, states.t, gravity=np.array(plan.task.physics.gravity))
    stage.hand(states.q, states.X_WO)
    stage.object(states.X_WO)
    if (table := plan.task.table) is not None:
        stage.table(table, states.X_WO[0, :3, 3])
    stage.contacts(course.p_WP, states.f_W, states.X_WO)
    touched_O = _just_above(course)
    for i in range(len(plan.fingers)):
        stage.way(i, touched_O[:, i], on_object=True)
    if _apart(states.X_WO[0], states.X_WO[-1]):
        stage.object(np.repeat(states.X_WO[-1:], len(states.t), axis=0), ghost=True)
    if failure is None:
        return add_panel(stage.html(), plan, course, stage.scene)
    verdict = ("no plan", "no", f"no plan ({failure.status}): {failure.reason}")
    stop = Stop(t=_stuck(plan), finger=failure.evidence.finger)
    facts = [fact for fact in certificate_facts(plan.certificate) if not fact[3]] if plan.certificate else []
    return add_panel(stage.html(), plan, course, stage.scene, facts=facts, verdict=verdict, stop=stop)


def _stuck(plan: Plan) -> float:
    """When a plan, all of which was found, fails its certificate; else its end."""
    worst = plan.certificate.worst if plan.certificate else {}
    failing = [_shown_at(plan, w.time_s, w.part) for w in worst.values() if not w.ok and w.time_s is not None]
    return min(failing, default=plan.duration)


def _shown_at(plan: Plan, time_s: float, part: int | None) -> float:
    """The time at which the page shows a part: just before its end, because at its end the next one begins."""
    return time_s if part is None else min(time_s, plan.parts[part].t[-1] - INSTANT_S)


def _just_above(course: Course) -> np.ndarray:
    """(k, F, 3) contact points in O, a little towards the fingertip, so that their path can be seen on the surface."""
    X_WO = course.states.X_WO
    lifted = course.p_WP + 0.05 * (course.p_WC - course.p_WP)
    return np.einsum("kji,kfj->kfi", X_WO[:, :3, :3], lifted - X_WO[:, None, :3, 3])


def _apart(X: np.ndarray, Y: np.ndarray) -> bool:
    """Whether two poses can be told apart by eye."""
    turn = np.arccos(np.clip((np.trace(X[:3, :3].T @ Y[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.linalg.norm(X[:3, 3] - Y[:3, 3]) > 4e-3 or turn > np.radians(8))


def serve_page(html: str, announce: Callable[[str], None], *, host: str = "127.0.0.1") -> None:
    """Serves a page on the first free port from 7000 on, until interrupted.

    Args:
        html: the page.
        announce: called with its address.
        host: address it listens on, and no other.

    Raises:
        InputError: this computer has no such address.
    """
    page = html.encode()

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200 if self.path == "/" else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            if self.path == "/":
                self.wfile.write(page)

        def log_message(self, *_: object) -> None:
            """Keeps stderr for messages that matter."""

    server = _listen(Page, host)
    with server:
        name = f"[{host}]" if ":" in host else host
        announce(f"http://{name}:{server.server_port}/")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return


def _listen(handler: type[BaseHTTPRequestHandler], host: str) -> ThreadingHTTPServer:
    class Server(ThreadingHTTPServer):
        address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

    for port in (*range(FIRST_PORT, FIRST_PORT + 100), 0):
        try:
            return Server((host, port), handler)
        except OSError as e:
            if e.errno != errno.EADDRINUSE:
                expected = "an address of this computer, or 0.0.0.0 for all of them"
                raise InputError("cannot listen there", key="--host", found=host, expected=expected) from e
    raise OSError("no free port")
