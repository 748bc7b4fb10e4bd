"""A recording of a long session that never ran, for measuring what reads recordings.

Every event goes through the recorder's own conversion and writer. The same arguments give the same
messages. In it: a slow bring-up, crashes over the whole time, a node that leaks memory until it
aborts, one that is not loaded again, the death of a container, and a process that is restarted.
"""
