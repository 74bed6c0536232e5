"""`MirrorView`: two hands in the browser, the measured one solid, the commanded one as its ghost (meshcat, yourdfpy).

meshcat's server runs in a thread of this process: no child that could outlive it, no waiting for its answers.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drake_hand.epos.mirror import HandPose
from drake_hand.epos.mirror_page import PAGE
from drake_hand.errors import DriveError, InputError, nearest

_SOLID, _GHOST, _GHOST_OPACITY = 0xC8CDD2, 0x2F7FD6, 0.35
_TWIN_COLOR = 0x2E9E4F
_OBJECT_COLOR = 0xE0A030
_GREY_COLOR, _RED_COLOR = np.array([0.78, 0.80, 0.82]), np.array([0.85, 0.10, 0.10])
_COLOR_SHADES = 8
RED_DEG = 5.0
"""Error at which a link is all red."""
_START_S = 10.0
_LEAST_CHANGE = 1e-5
"""Smallest change of a pose that is sent, m and rad."""


class _Server:
    """meshcat's bridge to the browser, in a thread; takes the place of the window of a `meshcat.Visualizer`.

    Args:
        host: address it listens on, and no other.
        port: its port; any that is free if not given.
    """

    def __init__(self, host: str, port: int | None) -> None:
        self._host, self._port = host, port
        self.state: dict = {}
        """What the page's panel shows."""
        self._ready = threading.Event()
        self._error: Exception | None = None
        self._bridge: Any
        self._thread = threading.Thread(target=self._run, name="mirror server", daemon=True)
        self._thread.start()
        if not self._ready.wait(_START_S) or self._error:
            raise DriveError(f"the mirror's web server did not start: {self._error or 'no answer'}")
        name = f"[{host}]" if ":" in host else host
        self.web_url = f"http://{name}:{self._bridge.fileserver_port}/lab"

    def _run(self) -> None:
        from meshcat.servers import zmqserver
        from tornado.web import Application, RequestHandler

        server = self

        class Lab(RequestHandler):
            """The page: meshcat's view, and a panel beside it."""

            def get(self) -> None:
                self.write(PAGE)

        class State(RequestHandler):
            """What the panel shows now."""

            def get(self) -> None:
                self.write(server.state)

        class Here(Application):
            """Listens on one address, where meshcat would on all."""

            def listen(self, port: int, address: str | None = None, **options: Any) -> Any:
                return super().listen(port, address or server._host, **options)

        class Browser(zmqserver.WebSocketHandler):
            """One browser; the one it replaces prints whenever it comes or goes."""

            def open(self) -> None:
                self.bridge.websocket_pool.add(self)
                self.bridge.send_scene(self)

            def on_close(self) -> None:
                self.bridge.websocket_pool.discard(self)

        class Bridge(zmqserver.ZMQWebSocketBridge):
            """Takes commands by call, not over ZMQ: `send` and `setup_zmq` are the socket it does not have."""

            def make_app(self) -> Application:
                files = {"path": zmqserver.VIEWER_ROOT, "default_filename": zmqserver.VIEWER_HTML}
                return Here(
                    [
                        (r"/static/(.*)", zmqserver.StaticFileHandlerNoCache, files),
                        (r"/lab", Lab),
                        (r"/state", State),
                        (r"/", Browser, {"bridge": self}),
                    ]
                )

            def setup_zmq(self, url: str) -> tuple[Any, None, str]:
                return self, None, url

            def send(self, answer: bytes) -> None:
                """Nobody waits for answers."""

        logging.getLogger("tornado.access").setLevel(logging.ERROR)
        asyncio.set_event_loop(asyncio.new_event_loop())
        try:
            with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(nowhere):
                self._bridge = Bridge(host=self._host, port=self._port)
        except Exception as e:
            self._error = e
            return
        finally:
            self._ready.set()
        self._bridge.run()

    def send(self, command: Any) -> None:
        """Takes a drawing command, as `meshcat.Visualizer` makes them."""
        import umsgpack

        data = command.lower()
        frames = [data["type"].encode(), data["path"].encode(), umsgpack.packb(data)]
        self._bridge.ioloop.add_callback(self._bridge.handle_zmq, frames)

    def stop(self) -> None:
        """Ends the server and its thread."""
        self._bridge.ioloop.add_callback(self._bridge.ioloop.stop)
        self._thread.join(_START_S)


class _HandModel:
    """One hand of the scene: its links' meshes, moved by forward kinematics.

    Args:
        urdf: file.
        joints: of the drives, in their order.
        path: in meshcat's tree.
        color: 0xRRGGBB.
        opacity: below 1 for a ghost.
    """

    def __init__(self, urdf: Path, joints: Sequence[str], path: Any, color: int, opacity: float) -> None:
        import trimesh
        import yourdfpy
        from meshcat.geometry import MeshPhongMaterial, TriangularMeshGeometry

        self._urdf, self._path = yourdfpy.URDF.load(str(urdf)), path
        actuated = list(self._urdf.actuated_joint_names)
        for joint in joints:
            if joint not in actuated:
                raise InputError(
                    f"the hand has no joint '{joint}'",
                    file=urdf,
                    key="joint",
                    found=joint,
                    expected=nearest(joint, actuated),
                )
        self._columns = [actuated.index(j) for j in joints]
        self._q = np.zeros(len(actuated))
        self._shown: dict[str, np.ndarray] = {}
        scene = self._urdf.scene
        parts: dict[str, list[Any]] = {}
        for node in scene.graph.nodes_geometry:
            link = scene.graph.transforms.parents[node]
            X_LG, name = scene.graph.get(node, frame_from=link)
            mesh = scene.geometry[name].copy()
            parts.setdefault(link, []).append(mesh.apply_transform(X_LG))
        material = MeshPhongMaterial(color=color, opacity=opacity, transparent=opacity < 1)
        if opacity < 1:  # where both coincide the solid one is seen
            material.properties |= {"polygonOffset": True, "polygonOffsetFactor": 2, "polygonOffsetUnits": 2}
            material.properties |= {"depthWrite": False}
        for link, meshes in parts.items():
            body: Any = trimesh.util.concatenate(meshes)
            # one vertex per corner: flat faces stay flat, edges stay sharp
            geometry = TriangularMeshGeometry(
                body.triangles.reshape(-1, 3), np.arange(3 * len(body.faces)).reshape(-1, 3)
            )
            path[link].set_object(geometry, material)
        self._links = list(parts)
        self._moved_by = {link: self._mover(link) for link in self._links}
        self._colors: dict[str, int] = {}
        bounds = np.asarray(scene.bounds)
        self.centre = bounds.mean(axis=0)
        """(3,) middle of its box, m."""
        self.size = float(np.linalg.norm(np.ptp(bounds, axis=0)))
        """Diagonal of its box, m."""
        for link, X_WL in self.move(np.zeros(len(joints))).items():
            self.show(link, X_WL)

    def move(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Moves to joint positions (n,) [rad], NaN leaves a joint where it is; poses (4, 4) of links that moved."""
        known = np.isfinite(q)
        self._q[np.array(self._columns)[known]] = q[known]
        self._urdf.update_cfg(self._q)
        moved = {}
        for link in self._links:
            X_WL = np.array(self._urdf.get_transform(link), float)  # a copy: yourdfpy keeps changing its own
            if link not in self._shown or np.abs(X_WL - self._shown[link]).max() > _LEAST_CHANGE:
                self._shown[link] = moved[link] = X_WL
        return moved

    def _mover(self, link: str) -> int | None:
        """Index among the drives' joints of the one that moves a link, the last before it; None for the palm."""
        by_child = {j.child: j for j in self._urdf.robot.joints}
        names = [self._urdf.actuated_joint_names[c] for c in self._columns]
        while link in by_child:
            joint = by_child[link]
            source = joint.mimic.joint if joint.mimic else joint.name
            if source in names:
                return names.index(source)
            link = joint.parent
        return None

    def color(self, error_deg: np.ndarray) -> None:
        """Colours links by the error (n,) of the joint that moves them; NaN leaves their own colour."""
        for link, joint in self._moved_by.items():
            share = 0.0 if joint is None else min(float(np.nan_to_num(error_deg[joint])) / RED_DEG, 1.0)
            step = round(share * _COLOR_SHADES)
            if self._colors.get(link, 0) != step:
                self._colors[link] = step
                rgb = _GREY_COLOR + (_RED_COLOR - _GREY_COLOR) * step / _COLOR_SHADES
                self._path[link].set_property("color", [*rgb.tolist(), 1.0])

    def show(self, link: str, X_WL: np.ndarray) -> None:
        """Draws a link at its pose (4, 4)."""
        self._path[link].set_transform(X_WL)


class MirrorView:
    """Both hands; made by :func:`open_view`."""

    def __init__(self, urdf: Path, joints: Sequence[str], host: str, port: int | None) -> None:
        import meshcat

        self._joints = list(joints)
        self._server = _Server(host, port)
        scene = meshcat.Visualizer(window=self._server)
        scene["/Background"].set_property("top_color", [0.95, 0.96, 0.97])
        scene["/Background"].set_property("bottom_color", [0.82, 0.85, 0.88])
        scene["/Grid"].set_property("visible", False)
        scene["/Axes"].set_property("visible", False)
        self._measured = _HandModel(urdf, joints, scene["hands/measured"], _SOLID, 1.0)
        self._commanded = _HandModel(urdf, joints, scene["hands/commanded"], _GHOST, _GHOST_OPACITY)
        # meshcat's camera orbits the origin, so the hands' middle goes there
        size, to_middle = self._measured.size, np.eye(4)
        to_middle[:3, 3] = -self._measured.centre
        scene["hands"].set_transform(to_middle)
        self._object = scene["hands/object"]
        self._twin: _HandModel | None = None
        self._add_twin = lambda: _HandModel(urdf, joints, scene["hands/twin"], _TWIN_COLOR, _GHOST_OPACITY)
        # from the palm's side, a little from above; in the camera's frame y is up
        scene["/Cameras/default/rotated/<object>"].set_property("position", [0.9 * size, 0.25 * size, 0.35 * size])

    @property
    def url(self) -> str:
        """Where to point the browser."""
        return self._server.web_url

    def add_object(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        """Puts the object of a plan beside the hands: vertices (v, 3) [m] and faces (f, 3)."""
        from meshcat.geometry import MeshPhongMaterial, TriangularMeshGeometry

        self._object.set_object(TriangularMeshGeometry(vertices, faces), MeshPhongMaterial(color=_OBJECT_COLOR))

    def add_twin(self) -> None:
        """Puts a third hand there, the simulated one, as a green ghost."""
        self._twin = self._add_twin()

    def show(
        self, pose: HandPose, X_WO: np.ndarray | None = None, words: str = "", twin: np.ndarray | None = None
    ) -> None:
        """Draws a pose; a commanded joint that is not known lies on the measured one.

        Args:
            pose: of both hands.
            X_WO: (4, 4) where the plan, or the twin, has the object.
            words: what stands above the panel.
            twin: (n,) joints of the simulated hand, rad.
        """
        if self._twin and twin is not None:
            for link, X_WL in self._twin.move(twin).items():
                self._twin.show(link, X_WL)
        if X_WO is not None:
            self._object.set_transform(X_WO)
        error = np.degrees(np.abs(pose.error))
        self._measured.color(error)
        states = [s.value for s in pose.states] or [""] * len(self._joints)
        rows = zip(self._joints, np.degrees(pose.commanded), np.degrees(pose.measured), error, states, strict=True)
        self._server.state = {"words": words, "red_deg": RED_DEG, "rows": [[_number(x) for x in row] for row in rows]}
        measured = self._measured.move(pose.measured)
        commanded = self._commanded.move(np.where(np.isfinite(pose.commanded), pose.commanded, pose.measured))
        # link by link, so that a browser which draws in between shows no false error
        for link in measured | commanded:
            for model, moved in ((self._measured, measured), (self._commanded, commanded)):
                if link in moved:
                    model.show(link, moved[link])

    def close(self) -> None:
        """Ends the server."""
        self._server.stop()


def _number(x: object) -> object:
    """JSON has no NaN."""
    return (round(float(x), 2) if np.isfinite(x) else None) if isinstance(x, float) else x


@contextmanager
def open_view(
    urdf: Path, joints: Sequence[str], host: str = "127.0.0.1", port: int | None = None
) -> Iterator[MirrorView]:
    """Opens the scene and serves it, until left.

    Args:
        urdf: of the hand.
        joints: of the drives, in their order.
        host: address to serve it on.
        port: its port; any that is free if not given.

    Raises:
        InputError: a joint is not in the URDF.
        DriveError: no port to serve it on.
    """
    view = MirrorView(urdf, joints, host, port)
    try:
        yield view
    finally:
        view.close()
