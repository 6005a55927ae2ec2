"""An IMU on a serial port or on the network, sent to `stridetwin live`.

The device sends one line per sample: microseconds of its own clock, angular rate (rad/s) and specific force (m/s²), as
`12345678,0.01,-0.02,0.00,0.1,0.2,9.8`. Other lines are skipped and counted.

    python examples/imu.py --topic /foot_l/imu --rig rig.yaml --udp 5005
    python examples/imu.py --topic /foot_l/imu --rig rig.yaml --serial /dev/ttyUSB0
    python examples/imu.py --topic /foot_l/imu --replay walk.mcap     # a recording in its place, through UDP
"""

import argparse
import socket
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
from replay import paced

from stridetwin.streams.formats.opening import open_any
from stridetwin.streams.kalibr import read_rig
from stridetwin.streams.live.sender import Sender
from stridetwin.streams.live.wire import parse_address
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Imu

CREEP = 100e-6  # rate error of the device's clock, at most


class DeviceClock:
    """Device time to system time: the line that arrived fastest gives the best offset.

    It starts again when the device's time goes back: its counter has wrapped, or it has been restarted.
    """

    def __init__(self) -> None:
        self.offset_ns, self.device_ns, self.last_ns = None, 0, 0

    def system_ns(self, device_ns: int) -> int:
        """System time, ns, of a line that has just arrived."""
        now_ns = time.time_ns()
        offset_ns = now_ns - device_ns
        if self.offset_ns is not None and device_ns > self.device_ns:
            offset_ns = min(offset_ns, self.offset_ns + int(CREEP * (now_ns - self.heard_ns)))
        self.offset_ns, self.heard_ns, self.device_ns = offset_ns, now_ns, device_ns
        self.last_ns = max(device_ns + offset_ns, self.last_ns + 1)  # stamps increase, whatever the clocks do
        return self.last_ns


def from_udp(listener: socket.socket) -> Iterator[str]:
    """Lines of datagrams, up to an empty one."""
    while text := listener.recv(2048).decode(errors="replace"):
        yield from text.splitlines()


def from_serial(port: str) -> Iterator[str]:
    """Lines of a serial port."""
    import serial  # pip install pyserial

    with serial.Serial(port, 921600) as device:
        device.readline()  # the rest of a line that had begun before
        while True:
            yield device.readline().decode(errors="replace")


def parsed(line: str) -> tuple[int, np.ndarray] | None:
    """Device time, ns, with (6,) rate and force; None if the line is not seven finite numbers."""
    words = line.split(",")
    try:
        device_ns, numbers = int(words[0]) * 1000, np.array([float(word) for word in words[1:]])
    except ValueError:
        return None
    return (device_ns, numbers) if numbers.shape == (6,) and np.isfinite(numbers).all() else None


def play(recording: Recording, topic: str, speed: float, port: int) -> None:
    """Sends the samples of a recording as the device would."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for sample in paced(recording, [topic], speed):
            numbers = ",".join(f"{v:.9g}" for v in (*sample.angular_rate, *sample.specific_force))
            out.sendto(f"{sample.t_ns // 1000},{numbers}".encode(), ("127.0.0.1", port))
        out.sendto(b"", ("127.0.0.1", port))


def main() -> None:
    """Sends until it is stopped."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--topic", default="/foot_l/imu")
    parser.add_argument("--rig", help="calibration, Kalibr YAML")
    parser.add_argument("--udp", type=int, default=0, metavar="PORT")
    parser.add_argument("--serial", metavar="DEVICE")
    parser.add_argument("--replay", help="recording in the place of the device")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--to", default="", help="HOST:PORT of stridetwin live")
    arguments = parser.parse_args()
    recording = open_any(arguments.replay) if arguments.replay else None
    rig = recording.rig if recording else read_rig(arguments.rig)
    if arguments.serial:
        lines = from_serial(arguments.serial)
    else:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.bind(("127.0.0.1" if recording else "", arguments.udp))
        lines, port = from_udp(listener), listener.getsockname()[1]
    if recording:
        threading.Thread(target=play, args=(recording, arguments.topic, arguments.speed, port), daemon=True).start()
    clock, skipped = DeviceClock(), 0
    with Sender(rig, parse_address(arguments.to, "--to"), epoch_ns=0) as sender:  # stamps are system time
        for line in lines:
            values = parsed(line)
            if values is None:
                skipped += 1
                if skipped == 1:
                    print(f"skipped {line[:80]!r}: expected time, rate and force", file=sys.stderr)
                continue
            device_ns, numbers = values
            t_ns = clock.system_ns(device_ns)
            sender.send(Imu(topic=arguments.topic, t_ns=t_ns, angular_rate=numbers[:3], specific_force=numbers[3:]))
    print(f"sent {dict(sender.sent)}, dropped {dict(sender.dropped)}, skipped {skipped} lines")


if __name__ == "__main__":
    main()
