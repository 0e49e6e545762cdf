"""Drives a robot from the keyboard: w and s change the speed, a and d turn, space stops, q ends. Needs ROS 2 for Twist."""
import sys, termios, tty
import ledgerd
from geometry_msgs.msg import Twist

KEYS = {"w": (0.1, 0.0), "s": (-0.1, 0.0), "a": (0.0, 0.2), "d": (0.0, -0.2)}
service, twist = sys.argv[1], Twist()
before = termios.tcgetattr(sys.stdin)
with ledgerd.connect() as robot, robot.acquire(service, wait=30) as grant:
    try:
        tty.setcbreak(sys.stdin)
        while (key := sys.stdin.read(1)) not in ("q", ""):
            linear, angular = KEYS.get(key, (-twist.linear.x, -twist.angular.z))
            twist.linear.x, twist.angular.z = twist.linear.x + linear, twist.angular.z + angular
            grant.publish(twist)
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
