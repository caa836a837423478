"""From depth images with class labels to the map a planner plans on (paper, section III-C), and a simulated camera."""
