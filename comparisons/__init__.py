"""Every QP solver on the same winding episodes, against the closed form and against each other."""
