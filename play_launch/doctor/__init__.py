"""What this machine can do: one function a check, each of which examines and judges its subject.

Nothing is changed. The container is started once, and stopped again.
"""
