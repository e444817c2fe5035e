"""What a robot is asked to do: tasks with a target, a gain and weights, each of which makes rows J dθ = e."""
