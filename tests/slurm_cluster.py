"""SLURM on this machine as this user: one node in a folder, on free ports; stopped by the ids that were started."""

import os
import secrets
import shutil
import socket
import subprocess
import time
from pathlib import Path

PROGRAMS = ("munged", "slurmctld", "slurmd")
# cred_expire is also how long a requeued job waits
CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.sock,cred_expire=20
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SlurmdParameters=config_overrides
ReturnToService=2
InactiveLimit=0
KillWait=5
MinJobAge=300
SchedulerParameters=batch_sched_delay=0,sched_interval=1,bf_interval=1
JobAcctGatherType=jobacct_gather/none
NodeName={host} NodeHostname={host} NodeAddr=127.0.0.1 CPUs=4 RealMemory=8000 State=UNKNOWN
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def program(name):
    """The place of a program that an ordinary user does not have in the path."""
    return shutil.which(name) or shutil.which(name, path="/usr/sbin:/sbin")


class Cluster:
    """munged, slurmctld and slurmd; `environment` for the commands of SLURM. Call stop()."""

    def __init__(self, folder):
        self.folder, self.processes = Path(folder), []
        for name in ("state", "spool"):
            (self.folder / name).mkdir()
        key = self.folder / "munge.key"
        key.write_bytes(secrets.token_bytes(128))
        key.chmod(0o600)
        user = subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()
        configuration = self.folder / "slurm.conf"
        configuration.write_text(CONFIGURATION.format(
            folder=self.folder, host=socket.gethostname().partition(".")[0], ports=_free_ports(), user=user
        ))  # fmt: skip
        self.environment = {**os.environ, "SLURM_CONF": str(configuration)}
        try:
            self._start("munged", "--foreground", "--force", f"--socket={self.folder}/munge.sock",
                        f"--key-file={key}", f"--log-file={self.folder}/munge.log", f"--seed-file={self.folder}/seed",
                        f"--pid-file={self.folder}/munged.pid")  # fmt: skip
            self._until(lambda: (self.folder / "munge.sock").exists(), "munged")
            self._start("slurmctld", "-D", "-i", "-f", str(configuration))
            self._start("slurmd", "-D", "-f", str(configuration))
            self._until(lambda: "idle" in self.ask("sinfo", "-h", "-o", "%T"), "the node")
        except BaseException:
            self.stop()
            raise

    def _start(self, name, *arguments):
        with open(self.folder / f"{name}.out", "wb") as output:
            self.processes.append(subprocess.Popen(
                [program(name), *arguments], stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                env=self.environment, start_new_session=True,
            ))  # fmt: skip

    def _until(self, ready, what, seconds=60):
        deadline = time.monotonic() + seconds
        while not ready():
            if time.monotonic() > deadline or any(process.poll() is not None for process in self.processes):
                logs = [path.read_text(errors="replace")[-1500:] for path in self.folder.glob("*.log")]
                logs += [path.read_text(errors="replace")[-1500:] for path in self.folder.glob("*.out")]
                raise RuntimeError(f"{what} did not start:\n" + "\n".join(logs))
            time.sleep(0.2)

    def ask(self, *command, **more):
        """What a command of SLURM says, on both channels."""
        run = subprocess.run(command, capture_output=True, text=True, env={**self.environment, **more}, timeout=60)
        return run.stdout + run.stderr

    def submit(self, folder, *arguments, **more):
        """Hand something to sbatch in a folder; the number of the job."""
        run = subprocess.run(["sbatch", "--parsable", *map(str, arguments)], capture_output=True, text=True, cwd=folder,
                             env={**more, "SLURM_CONF": self.environment["SLURM_CONF"]}, timeout=60)  # fmt: skip
        assert run.returncode == 0, run.stderr
        return run.stdout.strip().partition(";")[0]

    def states(self, job):
        """States of a job, or of the tasks of an array, in the order of the tasks."""
        lines = self.ask("squeue", "-h", "-r", "-t", "all", "-j", job, "-o", "%K %T").split("\n")
        return [line.split()[1] for line in sorted(lines) if len(line.split()) == 2]

    def wait(self, job, seconds=240):
        """The states of a job once none of its tasks waits or runs."""
        deadline = time.monotonic() + seconds
        while True:
            found = self.states(job)
            if found and not set(found) & {"PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "SUSPENDED"}:
                return found
            assert time.monotonic() < deadline, f"{found}: {self.ask('scontrol', 'show', 'job', job)}"
            time.sleep(0.3)

    def stop(self):
        """End what was started, the last first."""
        if len(self.processes) == 3:
            self.ask("scancel", "--full", f"--user={os.getuid()}")
            time.sleep(1)
        for process in reversed(self.processes):
            process.terminate()
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.processes = []


def _free_ports():
    sockets = [socket.socket() for _ in range(2)]
    for item in sockets:
        item.bind(("127.0.0.1", 0))
    ports = [item.getsockname()[1] for item in sockets]
    for item in sockets:
        item.close()
    return ports
