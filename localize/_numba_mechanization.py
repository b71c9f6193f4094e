"""Kernel of the inertial navigation: increments in, attitude, velocity and position out."""

import numpy as np
from numba import njit

from localize._numba_propagation import exp_so3


@njit(cache=True, inline="always")
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def mechanize(
    R, v, p, dtheta, dv, dt, before_theta, before_v, before_dt, rate, gravity, transport, out_R, out_v, out_p
):
    """Navigate over increments dtheta, dv (n, 3) of intervals dt (n,) [s] from R (3, 3), v, p (3,), all in map axes.

    before_*: increments of the interval before the first, before_dt 0 where there is none. out_* (n + 1, ...) receive
    the start and the state after every interval.
    """
    n = len(dt)
    out_R[0], out_v[0], out_p[0] = R, v, p
    dR, turned, half = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    last_theta, last_v, last_dt = before_theta.copy(), before_v.copy(), before_dt
    phi, force, a, b, c = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    navigation, coriolis, pull = np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        h = dt[k]
        # 1 / 12 for equal intervals; a rate that changes evenly gives this for any two
        share = h * h / (6.0 * last_dt * (last_dt + h)) if last_dt > 0.0 else 0.0
        _cross(last_theta, dtheta[k], a)
        for i in range(3):
            phi[i] = dtheta[k, i] + share * a[i]
        _cross(dtheta[k], dv[k], a)
        _cross(last_theta, dv[k], b)
        _cross(last_v, dtheta[k], c)
        for i in range(3):
            force[i] = dv[k, i] + 0.5 * a[i] + share * (b[i] + c[i])
        Rk, vk = out_R[k], out_v[k]
        for i in range(3):
            moved = transport[i, 0] * vk[0] + transport[i, 1] * vk[1] + transport[i, 2] * vk[2]
            navigation[i] = -h * (rate[i] + moved)
            coriolis[i] = 2.0 * rate[i] + moved
        _cross(coriolis, vk, a)
        exp_so3(0.5 * navigation, half)
        pull[:] = np.dot(half, np.dot(Rk, force))
        for i in range(3):
            out_v[k + 1, i] = vk[i] + pull[i] - h * a[i]
        out_v[k + 1, 2] -= h * gravity
        for i in range(3):
            out_p[k + 1, i] = out_p[k, i] + 0.5 * h * (vk[i] + out_v[k + 1, i])
        exp_so3(phi, dR)
        exp_so3(navigation, turned)
        out_R[k + 1] = np.dot(turned, np.dot(Rk, dR))
        last_theta[:], last_v[:], last_dt = dtheta[k], dv[k], h
