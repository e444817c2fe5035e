"""Winding by touch alone (Sec. 4): the plan, the controller, the episode and how to measure it."""
