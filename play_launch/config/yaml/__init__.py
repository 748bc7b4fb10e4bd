"""YAML 1.2 as a tree in which every key and value knows its place."""
