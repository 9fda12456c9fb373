"""What runs when Python is given this folder (see `hexapod-gateway` beside this file): the folder is searched first.

Started with -S, Python searches no packages of the machine. A wire of another's may be one of them, so their folder
comes last. A ROS 2 names its folders in PYTHONPATH.
"""

import os
import sys

if sys.argv[1:2] == ["ros2"]:
    sys.path += filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
sys.path += (f"/usr/local/lib/python3.{sys.version_info.minor}/dist-packages", "/usr/lib/python3/dist-packages")
sys.argv[0] = "/usr/bin/hexapod-gateway"

if sys.argv[1:] == ["take-release"]:  # by the package's postinst
    from gateway.onboard import release_switch

    sys.exit(release_switch.main())
from gateway.__main__ import main  # noqa: E402

main()
