"""How each process of a system is started: its command line, environment and folder."""
