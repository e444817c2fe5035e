"""QP solvers behind one protocol. A new solver is one file and one line of `registry.py`."""
