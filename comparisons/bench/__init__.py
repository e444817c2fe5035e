"""What a control step takes, beside what its neighbours take: interleaved in one process, certificate always on."""
