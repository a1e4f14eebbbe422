#!/bin/sh
# debian.sh RELEASE COMMAND...: run a command in a copy of this work tree, in a bare Debian of its own (as root).
# The system is made by debootstrap in build/RELEASE, or SYSTEMS/RELEASE, and kept; what it needs of networks is copied
# from this machine.
set -eu
release=$1; shift
cd "$(dirname "$0")/../.."
root=${SYSTEMS:-$PWD/build}/$release

if [ ! -e "$root.ready" ]; then
    command -v debootstrap >/dev/null || { apt-get update -qq && apt-get install -y -qq debootstrap; }
    rm -rf "$root" && mkdir -p "$root"
    debootstrap --variant=minbase --include=ca-certificates,make "$release" "$root"
    touch "$root.ready"
fi
for file in /etc/resolv.conf /etc/hosts /etc/pip.conf; do
    [ ! -e $file ] || cp -L $file "$root$file"
done
if [ -d /usr/local/share/ca-certificates ]; then
    cp -rL /usr/local/share/ca-certificates "$root/usr/local/share/"
    chroot "$root" update-ca-certificates >/dev/null 2>&1
fi

# the tracked and the new files, and the data beside them; the environment that an earlier run made stays
mkdir -p "$root/root/hpcred"
find "$root/root/hpcred" -mindepth 1 -maxdepth 1 ! -name .venv -exec rm -rf {} +
git -c safe.directory="$PWD" ls-files -co --exclude-standard -z | tar --null --ignore-failed-read -T - -cf - |
    tar xf - -C "$root/root/hpcred"
[ ! -d ../shared ] || cp -r ../shared "$root/root/"

# Names of their own for mounts and processes: both are gone with the command. So is /tmp: process numbers begin anew
# with each run, and Open MPI 5 does not start where a folder of the same number is left there.
exec unshare --mount --pid --fork sh -ec '
    root=$1; shift
    mount --rbind /dev "$root/dev"; mount -t proc proc "$root/proc"; mount -t sysfs sysfs "$root/sys"
    mount -t tmpfs tmpfs "$root/tmp"
    exec env -i HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin $(env | grep -i _proxy= || true) \
        chroot "$root" sh -c "cd /root/hpcred && exec \"\$@\"" sh "$@"' sh "$root" "$@"
