"""ROS 2: the simulated robot, or the law, as a node; bags written and replayed (`vstestbed ros`,
`replay`, `export --to rosbag2`).
"""
