"""Attacks on djpt: random scenes, arguments and files, run in processes that may die.

``python -m tests.fuzz --minutes 30`` runs as many as fit into half an hour; see CONTRIBUTING.md.
"""
