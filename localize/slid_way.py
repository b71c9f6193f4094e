"""A factor of the pose graph: a way that slid by a speed which is a variable."""

from __future__ import annotations

import gtsam
import numpy as np

from semmap.geometry import Array, skew


def slid(a: int, b: int, u: int, T_a_b: Array, seconds: float, covariance: Array) -> gtsam.CustomFactor:
    """From pose ``a`` to pose ``b`` it is ``T_a_b`` (4, 4) and, in b's axes, ``seconds`` times the speed ``u``.

    covariance : (6, 6) of the way besides, rotation first, perturbed at b.
    """
    T_b_a = gtsam.Pose3(T_a_b).inverse()

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        T_map_b = values.atPose3(b)
        way = values.atPose3(a).between(T_map_b)
        beyond = T_b_a.compose(way)
        R_b_map = T_map_b.rotation().matrix().T
        went = beyond.rotation().matrix().T @ beyond.translation()
        off = np.concatenate([gtsam.Rot3.Logmap(beyond.rotation()), went - seconds * (R_b_map @ values.atPoint3(u))])
        if H is not None:
            # the turn that is left is small: the logarithm's own derivative is one
            H[0], H[1], H[2] = np.eye(6), np.eye(6), np.zeros((6, 3))
            H[0][3:, :3], H[1][3:, :3] = skew(went), skew(off[3:])
            H[0] = -H[0] @ way.inverse().AdjointMap()
            H[2][3:] = -seconds * R_b_map
        return off

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(covariance), [a, b, u], error)
