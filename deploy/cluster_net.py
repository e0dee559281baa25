"""A network of its own for each host of a cluster: namespaces on one bridge, and a small disk for each daemon.

Invariant: nothing outside of these namespaces is changed, and all is removed at the end. Namespaces that an earlier run
left are removed first, with the processes in them.
"""

import os
import shutil
import signal
import subprocess

HUB = "tidemap-hub"
NET = "10.77.0"
HUB_IP = f"{NET}.254"
DISK_BYTES = 2 << 30


def run(*words, check=True):
    done = subprocess.run([str(word) for word in words], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True)
    if check and done.returncode:
        raise OSError(f"{' '.join(map(str, words))}: {done.stdout.strip()}")
    return done.stdout


def space(name):
    return f"tidemap-{name}"


def prefix(namespace):
    """The command line that runs a command in a namespace."""
    return ("ip", "netns", "exec", namespace)


class Network:
    """The hub with the bridge, and a namespace for each name. Clients run in the hub."""

    def __init__(self, names):
        self.names = list(names)
        self.remove()
        run("ip", "netns", "add", HUB)
        run("ip", "-n", HUB, "link", "set", "lo", "up")
        run("ip", "-n", HUB, "link", "add", "bridge", "type", "bridge")
        run("ip", "-n", HUB, "addr", "add", f"{HUB_IP}/24", "dev", "bridge")
        run("ip", "-n", HUB, "link", "set", "bridge", "up")
        for index, name in enumerate(self.names):
            run("ip", "netns", "add", space(name))
            run("ip", "-n", HUB, "link", "add", name, "type", "veth", "peer", "name", "eth0", "netns", space(name))
            run("ip", "-n", HUB, "link", "set", name, "master", "bridge")
            run("ip", "-n", HUB, "link", "set", name, "up")
            run("ip", "-n", space(name), "addr", "add", f"{self.ip(index)}/24", "dev", "eth0")
            for device in ("lo", "eth0"):
                run("ip", "-n", space(name), "link", "set", device, "up")

    @staticmethod
    def ip(index):
        return f"{NET}.{index + 1}"

    def cut(self, name, is_cut):
        run("ip", "-n", HUB, "link", "set", name, "down" if is_cut else "up")

    def remove(self):
        for namespace in [*map(space, self.names), HUB]:
            for pid in run("ip", "netns", "pids", namespace, check=False).split():
                if pid.isdigit():
                    try:
                        os.kill(int(pid), signal.SIGKILL)
                    except ProcessLookupError:
                        pass
            run("ip", "netns", "del", namespace, check=False)


def why_no_namespaces():
    """The reason why this machine cannot have the network; None if it can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "the program ip is missing: install iproute2"
    try:
        Network([]).remove()
    except OSError as error:
        return str(error)
    return None


class Disk:
    """A file system of its own at a folder, which can get full; a plain folder where there are no loop devices."""

    def __init__(self, folder, image):
        self.folder, self.image, self.why_not = folder, image, None
        self.ballast = folder / "ballast"
        folder.mkdir(parents=True, exist_ok=True)
        self.remove()
        try:
            if not image.exists():
                with open(image, "wb") as new:
                    new.truncate(DISK_BYTES)
                run("mkfs.ext4", "-q", "-m", "0", image)
            run("mount", "-o", "loop", image, folder)
        except OSError as error:
            self.why_not = str(error)
        self.ballast.unlink(missing_ok=True)

    def fill(self):
        left = os.statvfs(self.folder)
        size = left.f_bavail * left.f_frsize
        with open(self.ballast, "wb") as new:
            while size >= left.f_frsize:
                try:
                    os.posix_fallocate(new.fileno(), new.seek(0, os.SEEK_END), size)
                    new.seek(0, os.SEEK_END)
                except OSError:
                    size //= 2

    def empty(self):
        self.ballast.unlink(missing_ok=True)

    def remove(self):
        run("umount", self.folder, check=False)
