"""Everything that is particular to Fast DDS, the default middleware of ROS 2 Jazzy.

`middleware`: whether a process uses it; `shared_memory`: what killed processes leave of it;
`profiles`: whether it is configured by a profile; `announcements`: how our own
participants are configured; `waits`: that they come to an end. The rest of the program asks here,
and does nothing of it with another middleware. The container's part is in `main/fastdds.cpp` and
`base/fastdds_segments.cpp`.
"""
