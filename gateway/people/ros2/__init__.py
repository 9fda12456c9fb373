"""ROS 2's messages and this robot in them, without ROS 2. Pure: bytes and values.

`messages` has the types, `cdr` turns them into bytes. The bridge and a recording use the same.
"""
