"""ROS 2's messages and how they travel over Zenoh (rmw_zenoh), without ROS. Pure: bytes and values, and no session.

`messages` has the types, `cdr` turns them into bytes and back. A bridge and a recording use the same.
"""
