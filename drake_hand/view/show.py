"""A plan as a page in the browser: standalone HTML, or served until interrupted."""

from __future__ import annotations

from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory
from drake_hand.view.page import add_panel
from drake_hand.view.stage import Stage, frame_times

FIRST_PORT = 7000


def render(plan: Plan, scene: Scene) -> str:
    """A plan as one HTML page: hand and object, contact points and forces, mode and mode timeline, play, pause, scrub.

    Args:
        plan: what to show.
        scene: its hand and object.
    """
    states = Trajectory(plan).at(frame_times(plan.duration))
    stage = Stage(scene, states.t, gravity=np.array(plan.task.physics.gravity))
    stage.hand(states.q, states.X_WO)
    stage.object(states.X_WO)
    p_W = np.einsum("kij,kfj->kfi", states.X_WO[:, :3, :3], states.p_OP) + states.X_WO[:, None, :3, 3]
    for i, name in enumerate(plan.fingers):
        stage.contact(name, i, p_W[:, i], states.f_W[:, i])
    return add_panel(stage.html(), plan)


def serve(html: str, announce: Callable[[str], None]) -> None:
    """Serves a page on the first free port from 7000 on, also to other machines, until interrupted.

    Args:
        html: the page.
        announce: is told its address.
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

    server = _listen(Page)
    with server:
        announce(f"http://localhost:{server.server_port}/")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return


def _listen(handler: type[BaseHTTPRequestHandler]) -> ThreadingHTTPServer:
    for port in (*range(FIRST_PORT, FIRST_PORT + 100), 0):
        try:
            return ThreadingHTTPServer(("", port), handler)
        except OSError:
            continue
    raise OSError("no free port")
