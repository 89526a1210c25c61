"""Correct a large log with cameras: ``python -m tests.benchmarks.apply_large [--gigabytes 2]``.

It writes an MCAP file of random images of 1 MB and an IMU at 200 Hz, corrects it with ``imucal apply``, and
prints time and memory beside those of a plain copy of the file.
"""

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from imucal.calibration.exports import render_calibration
from tests.calibration.test_exports import FOUND
from tests.readers.logs import Message, imu_messages, samples, store, write_mcap

#: Bytes of an image.
IMAGE_BYTES = 1 << 20
#: IMU messages for each image: 200 Hz and 20 images per second.
IMU_PER_IMAGE = 10
#: Type of the camera's messages; only its bytes matter.
CAMERA_TYPE = "std_msgs/msg/String"


def messages(count: int) -> "list[Message]":
    """Return IMU messages, and after every tenth an image; all images share their bytes."""
    truth = samples(count * IMU_PER_IMAGE, rate=200.0, seed=95)
    image = np.random.default_rng(96).bytes(IMAGE_BYTES)
    every = []
    for number, message in enumerate(imu_messages(truth)):
        every.append(message)
        if number % IMU_PER_IMAGE == 0:
            every.append(Message(topic="/camera", type=CAMERA_TYPE, log=message.log + 1, data=image))
    return every


def main() -> None:
    """Write the log, correct it, and print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--compression", default="none")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        count = round(asked.gigabytes * 1e9 / IMAGE_BYTES)
        log = write_mcap(
            folder / "log.mcap",
            messages(count),
            compression=asked.compression,
            chunk_size=4 << 20,
            types=store(),
        )
        (folder / "imu.yaml").write_text(render_calibration(FOUND, "yaml"), encoding="utf-8")
        size = log.stat().st_size
        begun = time.perf_counter()
        shutil.copyfile(log, folder / "copy.mcap")
        copied = time.perf_counter() - begun
        (folder / "copy.mcap").unlink()
        begun = time.perf_counter()
        command = ["apply", str(folder / "imu.yaml"), str(log), "-o", str(folder / "out.mcap"), "-q"]
        subprocess.run([sys.executable, "-m", "imucal", *command], check=True)  # noqa: S603 - our own
        seconds = time.perf_counter() - begun
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        grown = (folder / "out.mcap").stat().st_size - size
    print(f"{size / 1e9:.2f} GB, {count * IMU_PER_IMAGE} samples: {seconds:.1f} s, {most:.0f} MB of memory")
    print(f"copy: {copied:.1f} s; ratio {seconds / copied:.1f}; {grown} bytes more")


if __name__ == "__main__":
    main()
