"""Everything that is particular to Fast DDS, the default middleware of ROS 2 Jazzy.

`middleware`: whether a process uses it, and whether its user has configured it; `shared_memory`:
leftovers of killed processes; `own_participant`: configuration of our participants, and waits that
end. Nothing of this applies to another middleware. The container's part is in `main/fastdds.cpp`
and `base/fastdds_segments.cpp`.
"""
