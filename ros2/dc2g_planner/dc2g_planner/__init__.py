"""The planners of dc2g_jax as a node of ROS 2."""
