"""`Estimate`: how far the object is off, and why, from measurements that come late and are noisy: a Kalman filter."""

from __future__ import annotations

import numpy as np

_START_RAD, _START_M = np.radians(3.0), 1.5e-3
"""How far the object may be off before anything was seen, standard deviation."""
_WANDER_RAD_SQRT_S, _WANDER_M_SQRT_S = np.radians(0.55), 0.27e-3
"""What else moves the object, in one second: a random walk, rad and m per sqrt(s)."""
_DRIFT_SHARE, _DRIFT_WANDER_SHARE_SQRT_S = 0.05, 0.02
"""Of a planned turn: how much more or less it may be, and how that changes from contact to contact."""
_LAG_S, _LAG_WANDER_S_SQRT_S = 0.01, 1e-3
"""By how much the object may lag behind the plan, s, and how that changes."""
_DRIFT_LIMIT_SHARE, _LAG_LIMIT_S = 0.15, 0.03
"""What of both is believed at most."""

_ERROR, _DRIFT, _LAG = slice(0, 6), 6, 7


class Estimate:
    """What is believed of an object that is held and turned as planned, or nearly: a linear Kalman filter.

    The state is the error, a twist from where the object is planned to where it is (rotation, then displacement of its
    centre, in W); its drift per planned turn, since tips that roll on yielding pads turn an object by a few per cent
    too much or too little; and the time by which it lags behind the plan, since servos do. Without the last, an object
    that turns at 8 rad/s would seem to be 5 deg off for 10 ms of lag, which are gone when it comes to rest.

    Args:
        noise: (6,) standard deviation of a measurement about and along each axis, rad and m; above 0.
    """

    def __init__(self, noise: np.ndarray) -> None:
        self._x, self._P = np.zeros(8), np.zeros((8, 8))
        self._Q = np.diag(
            [_WANDER_RAD_SQRT_S**2] * 3
            + [_WANDER_M_SQRT_S**2] * 3
            + [_DRIFT_WANDER_SHARE_SQRT_S**2, _LAG_WANDER_S_SQRT_S**2]
        )
        self._R = np.diag(noise**2)
        self._P[_DRIFT, _DRIFT], self._P[_LAG, _LAG] = _DRIFT_SHARE**2, _LAG_S**2
        self.forget()

    @property
    def error(self) -> np.ndarray:
        """(6,) the twist."""
        return self._x[_ERROR]

    @property
    def drift(self) -> float:
        """Per planned turn."""
        return float(self._x[_DRIFT])

    def forget(self) -> None:
        """The error is not known any more; drift and lag are."""
        self._x[_ERROR] = 0.0
        self._P[_ERROR, :] = self._P[:, _ERROR] = 0.0
        self._P[:3, :3], self._P[3:6, 3:6] = np.eye(3) * _START_RAD**2, np.eye(3) * _START_M**2

    def move(self, twist: np.ndarray, turned: np.ndarray, dt: float) -> None:
        """The object was moved on purpose, and turned as planned, which drifts.

        Args:
            twist: (6,) by which it was moved.
            turned: (3,) planned turn since the last call, rad.
            dt: since the last call, s.
        """
        self._x[:6] += twist
        self._x[:3] += self.drift * turned
        F = np.eye(8)
        F[:3, _DRIFT] = turned
        self._P = F @ self._P @ F.T + self._Q * dt

    def look(self, found: np.ndarray, thought: np.ndarray, w: np.ndarray) -> np.ndarray:
        """A measurement.

        Args:
            found: (6,) twist from where the object was planned, when it was seen, to where it was seen.
            thought: (6,) the error believed in then.
            w: (3,) planned angular velocity then, rad/s.

        Returns:
            (6,) what the error is believed to be off from what was thought.
        """
        H = np.zeros((6, 8))
        H[:, _ERROR] = np.eye(6)
        H[:3, _LAG] = -w
        K = np.linalg.solve(H @ self._P @ H.T + self._R, H @ self._P).T
        lagging = np.concatenate([w * self._x[_LAG], np.zeros(3)])
        change = K @ (found - thought + lagging)
        self._x += change
        self._P = self._P - K @ H @ self._P
        self._P = 0.5 * (self._P + self._P.T)
        self._x[_DRIFT] = np.clip(self._x[_DRIFT], -_DRIFT_LIMIT_SHARE, _DRIFT_LIMIT_SHARE)
        self._x[_LAG] = np.clip(self._x[_LAG], -_LAG_LIMIT_S, _LAG_LIMIT_S)
        return change[_ERROR]
