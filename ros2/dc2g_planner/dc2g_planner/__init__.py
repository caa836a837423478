"""The planners of dc2g_jax as a ROS 2 node, and as a DDS participant without ROS."""
