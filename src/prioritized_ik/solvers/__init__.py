"""From a problem to a joint step: the closed form, the QP stages, and the backends that solve them."""
