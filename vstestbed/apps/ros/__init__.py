"""ROS 2: the simulated robot, or the law, as a node; bags written and replayed."""

from vstestbed.core.apps import App

APP = App(
    commands={
        "ros": "vstestbed.apps.ros.commands:ros",
        "replay": "vstestbed.apps.ros.commands:replay",
    },
    exports={"rosbag2": "vstestbed.apps.ros.bag:ROSBAG2"},
    records=dict.fromkeys((".mcap", ".db3", "metadata.yaml"), "vstestbed.apps.ros.bag:read_record"),
)
