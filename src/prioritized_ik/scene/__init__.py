"""Scenes: a robot, what it is asked to do over time, and its limits, as a task file says."""
