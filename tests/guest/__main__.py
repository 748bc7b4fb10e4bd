"""Runs tests in a virtual machine whose kernel or processor this machine has not.

    python -m tests.guest [NAME|FILE...]             each file of tests/guest/cases
    python -m tests.guest --older [NAME|FILE...]     of tests/guest/older; Debian 11's kernel, 5.10
    python -m tests.guest --arm64 [--older] FOLDER   C++ tests of isolation, built there for AArch64

The machine is emulated: it has protection keys and all controllers of cgroup v2, whatever this one
has. It sees this machine's file system; what it changes there is lost with it. A case is an
executable file, there or elsewhere: its exit status is 0, or 77 where it has to be skipped. PYTHON
is the interpreter that this one runs in, SLOW how much slower than outside programs may be,
NATIVE_TESTS where the C++ tests were built. For AArch64 there are the tests and the C library only.

Needs qemu-system-x86_64 and busybox (static), for AArch64 qemu-system-aarch64 and the cross
compiler's libraries, cpio, and a Debian that offers its kernel by `apt-get download`; that is kept
in GUEST_CACHE, by default ~/.cache/play-launch/guest. Exit status: 0 all passed, 1 some did not, 77
it cannot be run here.
"""

from __future__ import annotations

import gzip
import lzma
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
SKIPPED = 77
LIMIT = int(os.environ.get("GUEST_LIMIT", "1800"))
"""Seconds of CPU time for all of it: how long that takes depends on what else the machine does."""
LONGEST = 3600.0
"""Seconds for a machine that does nothing."""
CROSS_LIBRARIES = Path("/usr/aarch64-linux-gnu/lib")
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay")
"""What mounts the host's files; the modules that these need are found in them."""
INIT = """#!/busybox sh
B=/busybox
$B mount -t proc proc /proc; $B mount -t sysfs sys /sys; $B mount -t devtmpfs dev /dev
for module in /m/*.ko; do $B insmod $module; done
$B mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=512000 host /ro
$B mount -t tmpfs -o size=80% tmp /rw; $B mkdir /rw/u /rw/w
$B mount -t overlay -o lowerdir=/ro,upperdir=/rw/u,workdir=/rw/w over /new
for folder in proc sys dev; do $B mount --move /$folder /new/$folder; done
$B mkdir -p /new/dev/shm /new/dev/pts /new/job
$B mount -t tmpfs tmp /new/run; $B mount -t tmpfs tmp /new/dev/shm
$B mount -t devpts pts /new/dev/pts
$B mount -t cgroup2 none /new/sys/fs/cgroup
$B mount -t 9p -o trans=virtio,version=9p2000.L,cache=none,msize=512000 job /new/job
$B ip link set lo up; $B hostname guest
cd /new; exec $B switch_root /new /bin/bash /job/main
"""
# Folders of root are closed to the user outside, whose rights the guest's root has on its files.
MAIN = """export HOME=/run PYTEST_DEBUG_TEMPROOT=/run
export LANG=C.UTF-8 PATH={path} PYTHON={python} SLOW=10
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST NATIVE_TESTS={native_tests}
cd {folder}
for case in {cases}; do
  name=$(basename $case)
  $case >/job/$name.out 2>&1; echo $? >/job/$name.status
done
busybox poweroff -f
"""
KERNEL_ARGUMENTS = (
    "console=ttyS0 quiet panic=-1 mitigations=off nopti nokaslr norandmaps cgroup_no_v1=all "
    "audit=0 tsc=reliable no_timer_check random.trust_cpu=on"
)
ARM64_INIT = """#!/busybox sh
/busybox mkdir -p /bin; /busybox --install -s /bin
export PATH=/bin HOME=/root LD_LIBRARY_PATH=/lib {environment}
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
mkdir -p /dev/shm /dev/pts; mount -t tmpfs shm /dev/shm; mount -t devpts pts /dev/pts
ip link set lo up; ulimit -n 1024
cd {folder}
for program in *_test; do
  ./$program >/tmp/out 2>&1; status=$?
  [ $status = 0 ] || [ $status = 77 ] || cat /tmp/out
  echo "$program ended with $status"
done
poweroff -f
"""


class MissingError(Exception):
    """Why it cannot be run here."""


def apt(*command: str, folder: str | None = None) -> str:
    done = subprocess.run(command, check=False, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise MissingError(f"{command[0]}: {done.stderr.strip()}")
    return done.stdout


def lists_of(architecture: str, release: str, work: Path) -> list[str]:
    """Read another release's lists of packages from this machine's mirror; apt's options for it."""
    uris = apt("apt-get", "indextargets", "--format", "$(REPO_URI)", "Created-By: Packages").split()
    main = next((uri for uri in uris if "security" not in uri), None)
    if main is None:
        raise MissingError("apt knows no mirror")
    (work / "sources.list").write_text(f"deb {main} {release} main\n")
    for name in ("state/lists/partial", "cache/archives/partial"):
        (work / name).mkdir(parents=True)
    settings = {
        "Dir::State": work / "state",
        "Dir::State::status": "/dev/null",  # what is installed here
        "Dir::Cache": work / "cache",
        "Dir::Etc::sourcelist": work / "sources.list",
        "Dir::Etc::sourceparts": "/dev/null",
        "APT::Sandbox::User": "root",
        "APT::Architecture": architecture,
        "APT::Architectures": architecture,
    }
    options = [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]
    apt("apt-get", *options, "update")
    return options


def kernel(cache: Path, *, arm64: bool, older: bool) -> Path:
    """Fetch Debian's kernel unless it is there, for AArch64 busybox with it; gives the folder."""
    folder = cache / ("kernel" + "-arm64" * arm64 + "-older" * older)
    if not folder.is_dir():
        architecture = "arm64" if arm64 else "amd64"
        with tempfile.TemporaryDirectory(dir=cache) as work:
            # This release is read as it is, unless it is for another processor.
            release = "bullseye" if older else "bookworm"
            options = lists_of(architecture, release, Path(work)) if arm64 or older else []
            found = apt("apt-cache", *options, "depends", f"linux-image-{architecture}")
            # Not the one for clouds, which cannot mount the host's files.
            package = re.search(r"Depends: (linux-image-\S+)", found)
            if package is None:
                raise MissingError(f"apt knows no linux-image-{architecture}")
            apt(
                "apt-get",
                *options,
                "download",
                package[1],
                *["busybox-static"] * arm64,
                folder=work,
            )
            for archive in Path(work).glob("*.deb"):
                subprocess.run(["dpkg", "-x", archive, f"{work}/tree"], check=True)
            Path(work, "tree").rename(folder)
    return folder


def packed(root: Path, archive: Path) -> Path:
    """Make the archive of what is there when the kernel starts."""
    names = "\n".join(str(each.relative_to(root)) for each in sorted(root.rglob("*")))
    done = subprocess.run(
        ["cpio", "-o", "-H", "newc", "--quiet"],
        input=names.encode(),
        cwd=root,
        capture_output=True,
        check=True,
    )
    archive.write_bytes(gzip.compress(done.stdout, 1))
    return archive


def started_with(root: Path, init: str, *folders: str) -> None:
    for name in ("proc", "sys", "dev", *folders):
        (root / name).mkdir(parents=True)
    (root / "init").write_text(init)
    (root / "init").chmod(0o755)


def loaded_modules(tree: Path) -> dict[str, bytes]:
    """Read the kernel's modules, each behind those it needs; by name, dashes as underscores."""
    files = {
        file.name.partition(".")[0].replace("-", "_"): file
        for file in tree.glob("lib/modules/*/kernel/**/*.ko*")
    }
    loaded: dict[str, bytes] = {}

    def load(name: str) -> None:
        if name not in loaded and name in files:  # else it is a part of the kernel
            module = files[name].read_bytes()
            if files[name].suffix == ".xz":
                module = lzma.decompress(module)
            needed = re.search(rb"\0depends=([\w,-]*)\0", module)
            for each in needed[1].decode().split(",") if needed else []:
                load(each.replace("-", "_"))
            loaded[name] = module

    for name in MODULES:
        load(name)
    return loaded


def first_files(tree: Path, work: Path) -> Path:
    """Make the archive of what runs before the host's files are there."""
    root = work / "root"
    started_with(root, INIT, "m", "ro", "rw", "new")
    shutil.copy(shutil.which("busybox") or "", root / "busybox")
    for number, (name, module) in enumerate(loaded_modules(tree).items(), 10):
        (root / "m" / f"{number}-{name}.ko").write_bytes(module)
    return packed(root, work / "first_files")


def arm64_files(tree: Path, tests: Path, work: Path, environment: str) -> Path:
    """Make the archive of busybox, the C and C++ libraries, and the tests where they were built."""
    root = work / "root"
    started_with(root, ARM64_INIT.format(environment=environment, folder=tests), "lib", "tmp")
    shutil.copy(tree / "bin/busybox", root / "busybox")
    for name in ("ld-linux-aarch64.so.1", "libc.so.6", "libm.so.6", "libgcc_s.so.1"):
        shutil.copy(CROSS_LIBRARIES / name, root / "lib" / name)
    shutil.copy(CROSS_LIBRARIES / "libstdc++.so.6", root / "lib")
    folder = root / str(tests).lstrip("/")
    folder.mkdir(parents=True, exist_ok=True)
    for each in (*tests.glob("*_test"), *tests.glob("*.so")):
        shutil.copy(each, folder)
    return packed(root, work / "first_files")


def boot(tree: Path, *command: str) -> None:
    """Run the machine to its end."""
    (image,) = (tree / "boot").glob("vmlinuz-*")
    common = ("-accel", "tcg,thread=multi", "-smp", "2", "-nodefaults", "-no-user-config")
    shown = ("-display", "none", "-no-reboot", "-kernel", str(image))
    with subprocess.Popen([*command, *common, *shown]) as machine:
        resource.prlimit(machine.pid, resource.RLIMIT_CPU, (LIMIT, LIMIT))
        try:
            machine.wait(LONGEST)
        except subprocess.TimeoutExpired:
            machine.kill()
    if machine.returncode:
        print(f"the machine was ended: it may use {LIMIT} s of CPU time, and take {LONGEST:g} s")


def outcome(job: Path, case: Path) -> bool:
    """Print how a case ended; False: it failed."""
    status = job / f"{case.name}.status"
    number = int(status.read_text() or -1) if status.is_file() else -1
    out = job / f"{case.name}.out"
    text = out.read_text(errors="replace") if out.is_file() else ""
    words = {0: "passed", SKIPPED: "skipped", -1: "did not end"}
    print(f"{case.name}: {words.get(number, f'failed with status {number}')}")
    print("".join(f"    {line}\n" for line in text.splitlines()), end="")
    return number in {0, SKIPPED}


def run_cases(tree: Path, job: Path, cases: Sequence[Path]) -> bool:
    main = MAIN.format(
        path=os.environ["PATH"],
        python=sys.executable,
        folder=HERE,
        cases=" ".join(map(str, cases)),
        native_tests=os.environ.get("NATIVE_TESTS", ""),
    )
    (job / "main").write_text(main)
    boot(
        tree,
        *("qemu-system-x86_64", "-M", "q35", "-cpu", "max", "-m", "3G"),
        *("-serial", f"file:{job}/console", "-initrd", str(first_files(tree, job))),
        *("-append", KERNEL_ARGUMENTS),
        *("-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap"),
        *("-device", "virtio-9p-pci,fsdev=host,mount_tag=host"),
        *("-fsdev", f"local,id=job,path={job},security_model=none"),
        *("-device", "virtio-9p-pci,fsdev=job,mount_tag=job"),
    )
    ended = [outcome(job, case) for case in cases]
    return all(ended)


def run_on_arm64(tree: Path, job: Path, tests: Path, *, older: bool) -> bool:
    files = arm64_files(tree, tests, job, "ENDS_BY_KILL=1" if older else "")
    boot(
        tree,
        *("qemu-system-aarch64", "-M", "virt", "-cpu", "max", "-m", "1536"),
        *("-serial", f"file:{job}/console", "-initrd", str(files)),
        *("-append", "console=ttyAMA0 quiet panic=-1 mitigations=off audit=0"),
    )
    console = (job / "console").read_text(errors="replace")
    ended = dict(re.findall(r"^(\w+_test) ended with (\d+)\s*$", console, re.MULTILINE))
    print("\n".join(f"{name}: {status}" for name, status in ended.items()))
    names = {each.name for each in tests.glob("*_test")}
    return ended.keys() == names and {*ended.values()} <= {"0", str(SKIPPED)}


def main(arguments: Sequence[str]) -> int:
    """Run it; the exit status."""
    arm64, older = "--arm64" in arguments, "--older" in arguments
    names = [each for each in arguments if not each.startswith("--")]
    programs = ["cpio", "apt-get", "dpkg"]
    programs += ["qemu-system-aarch64"] if arm64 else ["qemu-system-x86_64", "busybox"]
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        print(f"no virtual machine: not installed: {', '.join(missing)}")
        return SKIPPED
    try:
        cache = Path(os.environ.get("GUEST_CACHE") or Path.home() / ".cache/play-launch/guest")
        cache.mkdir(parents=True, exist_ok=True)
        tree = kernel(cache, arm64=arm64, older=older)
    except MissingError as error:
        print(f"no virtual machine: {error}")
        return SKIPPED
    with tempfile.TemporaryDirectory(dir=cache) as folder:
        job = Path(folder)
        if arm64:
            passed = run_on_arm64(tree, job, Path(names[0]).resolve(), older=older)
        else:
            place = HERE / ("older" if older else "cases")
            given = [Path(each) if "/" in each else place / each for each in names]
            cases = [each.resolve() for each in given] or sorted(place.iterdir())
            passed = run_cases(tree, job, cases)
        if not passed:
            console = job / "console"
            print(console.read_text(errors="replace")[-4000:] if console.is_file() else "")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
