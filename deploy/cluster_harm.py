"""The kinds of faults that a host of a cluster can have. Each is done and healed.

Invariant: the draws of a fault follow from the seed and the number of the fault; the moment at which it hits does not.
"""

import shutil
import signal
import time

import cluster_kit as kit

# The kinds, with the frequency with which they are drawn.
KINDS = {
    "kill_daemon": 4,
    "kill_engine": 3,
    "kill_both": 4,
    "stop_daemon": 2,
    "stop_engine": 2,
    "stop_both": 2,
    "cut": 4,
    "kill_majority": 2,
    "forget_one": 2,
    "forget_two": 2,
    "forget_live": 2,
    "forget_first": 4,
    "forget_all": 2,
    "disk_full": 3,
    "rolling": 1,
    # This kind is not drawn: it is a loss that must be found, to test the run itself.
    "planted_loss": 0,
}


class Harm:
    """A fault of a host. `begun` is when the harm is done."""

    def __init__(self, life, host, draws):
        self.life, self.cluster, self.host, self.draws = life, life.cluster, host, draws
        self.others = [other for other in self.cluster.hosts if other is not host]
        self.begun = time.time()

    def do(self, kind):
        getattr(self, kind)()

    def pause(self, least, longest):
        time.sleep(self.draws.uniform(least, longest))

    def image(self, host):
        return host.folder / "image-engine"

    def keep_image(self, host):
        """Copies the engine's folder, for a later fault; while it is stopped that is a sound image."""
        shutil.rmtree(self.image(host), ignore_errors=True)
        # A running engine removes files meanwhile.
        try:
            shutil.copytree(host.store, self.image(host))
        except shutil.Error:
            pass

    def set_back(self, host):
        """Sets a stopped engine back to its image, if there is one."""
        if self.image(host).exists():
            shutil.rmtree(host.store, ignore_errors=True)
            shutil.copytree(self.image(host), host.store)

    def killed(self, host, *whats, keeps_image=False):
        self.begun = time.time()
        self.cluster.kill(host, *whats)
        if keeps_image:
            self.keep_image(host)
        self.pause(1, 10)
        for what in whats:
            self.cluster.start(host, what)

    def kill_daemon(self):
        self.killed(self.host, "daemon")

    def kill_engine(self):
        self.killed(self.host, "engine", keeps_image=True)

    def kill_both(self):
        self.killed(self.host, "engine", "daemon", keeps_image=True)

    def stopped(self, *whats):
        self.begun = time.time()
        for what in whats:
            self.cluster.send(self.host, what, signal.SIGSTOP)
        try:
            self.pause(5, 15)
        finally:
            for what in whats:
                self.cluster.send(self.host, what, signal.SIGCONT)

    def stop_daemon(self):
        self.stopped("daemon")

    def stop_engine(self):
        self.stopped("engine")

    def stop_both(self):
        self.stopped("daemon", "engine")

    def cut(self):
        self.begun = time.time()
        self.life.network.cut(self.host.name, True)
        try:
            self.pause(5, 20)
        finally:
            self.life.network.cut(self.host.name, False)

    def kill_majority(self):
        """Two of three engines, with the machine's own among them."""
        hit = [self.host, self.draws.choice(self.others)]
        self.begun = time.time()
        for host in hit:
            self.cluster.send(host, "engine", signal.SIGKILL)
        for host in hit:
            self.cluster.kill(host, "engine")
        self.pause(1, 15)
        for host in hit:
            self.cluster.start(host, "engine")

    def forget(self, hit):
        """Engines lose what they have written since their images were taken."""
        self.begun = time.time()
        for host in hit:
            self.cluster.send(host, "engine", signal.SIGKILL)
        for host in hit:
            self.cluster.kill(host, "engine")
            self.set_back(host)
        self.pause(0, 3)
        for host in hit:
            self.cluster.start(host, "engine")

    def forget_one(self):
        self.forget([self.host])

    def forget_two(self):
        hit = [self.host, self.draws.choice(self.others)]
        for host in hit:
            if not self.image(host).exists():
                self.keep_image(host)
        self.forget(hit)

    def forget_live(self):
        """Two engines are set back by a few seconds, to copies that were taken while they ran."""
        self.forget(self.keep_two_images())

    def keep_two_images(self):
        """Two hosts whose engines can be set back by a few seconds."""
        hit = [self.host, self.draws.choice(self.others)]
        for host in hit:
            self.keep_image(host)
        self.pause(3, 6)
        return hit

    def forget_first(self, parts=("engine",)):
        """All engines die. Two are set back by a few seconds, and elect before the third one comes."""
        hit = self.keep_two_images()
        self.begun = time.time()
        self.restart_forgetting(hit, parts)

    def forget_all(self):
        """Does the same as `forget_first`, and the daemons die too."""
        self.forget_first(("engine", "daemon"))

    def restart_forgetting(self, hit, whats):
        for host in self.cluster.hosts:
            for what in whats:
                self.cluster.send(host, what, signal.SIGKILL)
        for host in self.cluster.hosts:
            self.cluster.kill(host, *whats)
        for host in hit:
            self.set_back(host)
        for host in self.cluster.hosts:
            for what in whats:
                if what == "daemon" or host in hit:
                    self.cluster.start(host, what)
        self.pause(5, 12)
        for host in self.cluster.hosts:
            self.cluster.start(host, "engine")

    def planted_loss(self):
        """Two engines forget, and no daemon has a disk that comes back."""
        hit = [self.host, self.draws.choice(self.others)]
        for host in hit:
            self.keep_image(host)
        self.pause(5, 6)
        self.begun = time.time()
        for host in self.cluster.hosts:
            self.cluster.kill(host, "engine", "daemon")
            for path in host.data.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        self.restart_forgetting(hit, ("engine", "daemon"))

    def disk_full(self):
        disk = self.life.disks[self.host.name]
        self.begun = time.time()
        disk.fill()
        try:
            self.pause(4, 12)
        finally:
            disk.empty()

    def rolling(self):
        """All daemons end in order and start again, one after the other."""
        self.begun = time.time()
        for host in self.cluster.hosts:
            self.cluster.kill(host, "daemon", number=signal.SIGTERM)
            self.cluster.start(host, "daemon")
            kit.wait_until(f"{host.name} is back", lambda host=host: self.is_back(host), within=60)

    def is_back(self, host):
        return self.cluster.tidemap(host, "cluster", "status", timeout=10)[0] == 0
