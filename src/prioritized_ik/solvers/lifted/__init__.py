"""The levels of a problem on a kinematic tree as sparse QPs, for sparse QP solvers: `motion`, `stages`, `fold`."""
