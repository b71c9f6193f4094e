"""semmap: where a robot is in an underground mine, told by the mine's intersections.

This package is the vocabulary every other room uses: geometry, measurements, the rig, recordings in and
trajectories out, intersections and the semantic map with its HDF5 file.

Conventions, once for the whole project
---------------------------------------
* Frames: ``map`` (surveyed mine), ``odom`` (where the filter started, z up along gravity), ``imu`` (the
  body), ``lidar``, ``wheel``, ``tag`` (UWB), ``prism`` (total station). Axes follow REP-103: x forward,
  y left, z up.
* ``T_a_b`` (4, 4) takes points of frame b into frame a; ``R_a_b``, ``p_a``, ``v_a`` likewise.
* Units: metres, seconds, radians, m/s², unless a name says otherwise (``_deg``, ``_ns``).
* Time stamps are int64 nanoseconds (``stamp_ns``); float seconds are used only for differences.
* Quaternions appear only at file borders, always in the order x y z w.
* Rotation vectors perturb on the right, ``R ← R Exp(θ)``; six-vectors and 6x6 covariances have
  rotation first.
"""

__version__ = "0.1.0"
