"""Offline: a prior point cloud into a semantic map of intersections. The same geometry serves the live keyframes.

``read_prior_map -> split_ground_and_walls -> roadway_topology -> find_intersections -> describe`` (`maps.build`),
and for stacked keyframes the same from the free space on (`maps.observe`).
"""
