"""Control groups (cgroup v2) of a session: one for each member and each isolated node.

::

    <base>/                                   the delegated group, or `base_path`
        play-launch-supervisor/               the processes of <base>, if that is our own group
        play-launch-<namespace>-<pid>-<start>/    a session, by its supervisor
            <member>/                         limits of a container with its nodes, or of a process
                container/                    the process of an isolated container
                <node>.<attempt>/             the process of an isolated node, its limits

Processes are in leaves only, as the kernel demands of groups with controllers, and start there.
"""
