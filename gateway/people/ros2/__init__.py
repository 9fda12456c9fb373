"""ROS 2's messages and this robot in them, without ROS 2. Pure: bytes and values.

`messages` has the types, `cdr` turns them into bytes, `drawing` draws the robot's reports with them. The bridge, a
recording and an exported incident use the same.
"""
