"""What `python -m experiments.benchmark` and the commands that time something measure, part by part."""
