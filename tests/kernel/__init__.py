"""`make kernel`: the gateway on the spidev of a real Linux kernel, in a virtual machine.

`python -m tests.kernel` downloads QEMU and Debian's kernel into `build/kernel` without installing them, builds the SPI
controller of `module/`, boots, and runs the scenes of `inside/` there, on this machine's files (read-only) and this
Python. The controller has no hardware: it records chip select, bytes, speed, mode and pauses, and can fail, lose and
hang. Times mean little under emulation; orders, edges, bytes and least times do.

`--arm64` (`arm64.py`) boots Debian's kernel for arm64 on a Debian 12 of its own, installs the package there, and plays
scenes of the bus and of a service under systemd (`inside/shipped.py`).
"""
