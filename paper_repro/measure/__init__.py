"""What is measured for the artefacts: jobs with JSON answers, and what the paper says computed another way."""
