"""Frontiers, the planners built on them, and the planner on a robot, one call at a time."""
