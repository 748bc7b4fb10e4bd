"""Everything that is particular to Fast DDS, the default middleware of ROS 2 Jazzy.

`middleware`: whether a process uses it; `shared_memory`: leftovers of killed processes; `profiles`:
whether the user has configured it; `own_participant`: configuration of our participants; `waits`:
replaced waits, so that they end. Nothing of this applies to another middleware. The container's
part is in `main/fastdds.cpp` and `base/fastdds_segments.cpp`.
"""
