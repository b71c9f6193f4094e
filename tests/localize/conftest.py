"""Shared by the localize tests: a random state, and one numerical check for every Jacobian."""

from collections.abc import Callable

import numpy as np
import pytest

from localize.state import NavState
from semmap.geometry import se3, so3_exp


def random_state(rng: np.random.Generator) -> NavState:
    def pose():
        return se3(so3_exp(rng.normal(size=3)), rng.normal(size=3))

    g = rng.normal(size=3)
    return NavState(
        R=so3_exp(rng.normal(size=3)), p=rng.normal(size=3), v=rng.normal(size=3), gyro_bias=0.1 * rng.normal(size=3),
        accel_bias=0.1 * rng.normal(size=3), g=9.81 * g / np.linalg.norm(g), T_imu_lidar=pose(), T_imu_tag=pose(),
        T_imu_wheel=pose(), T_odom_clone=pose(), T_odom_map=pose(), map_centre=rng.normal(size=3),
    )  # fmt: skip


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(42)


@pytest.fixture
def check_jacobian() -> Callable[..., None]:
    """Compare a Jacobian over some error columns with central differences of the residual."""

    def check(residual, jacobian, state, columns, *, step=1e-6, atol=1e-6):
        numeric = np.empty_like(jacobian)
        for k, column in enumerate(columns):
            delta = np.zeros(state.dim)
            delta[column] = step
            numeric[:, k] = (residual(state.boxplus(delta)) - residual(state.boxplus(-delta))) / (2 * step)
        np.testing.assert_allclose(jacobian, numeric, atol=atol)

    return check


@pytest.fixture
def state(rng) -> NavState:
    return random_state(rng)


@pytest.fixture
def located(rng) -> NavState:
    """A state with a tail: odom lies somewhere in the map, and two anchors were heard."""
    state = random_state(rng)
    state.wheel_scale, state.anchors, state.range_biases = 1.1, (7, 3), rng.normal(size=2)
    state.T_map_odom = se3(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    state.odom_centre = rng.normal(size=3)
    state.clock_offset = 0.2 * rng.normal()
    return state
