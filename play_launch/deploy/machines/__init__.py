"""Several machines: each runs an ordinary session of its part, and a coordinator accompanies them.

Owns the connections, what is started where, and the requests of clients that are for all machines.
It knows the parts by their control sockets only.
"""
