"""`ros2 ledger acquire|release|status|stop`. Only ros2cli imports these modules; nothing else of the package needs ROS 2."""
