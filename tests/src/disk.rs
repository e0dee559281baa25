//! Disks that can be cut off, and disks that are small: loop devices and file systems in memory. They need root.
//!
//! Invariant: mounts and loop devices are released when their handles are dropped. The power-cut model
//! keeps exactly the block writes that were issued before the cut, in order. A real power cut can be worse.

use std::{
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Size of an image; only written blocks take space.
const IMAGE_BYTES: u64 = 256 << 20;

/// Why there are no such disks on this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unavailable(pub String);

fn run<T: AsRef<OsStr>>(program: &str, args: impl IntoIterator<Item = T>) -> Result<String, String> {
    // mkfs and losetup may be outside the PATH of an ordinary user.
    let path = format!("{}:/usr/sbin:/sbin", std::env::var("PATH").unwrap_or_default());
    let mut command = Command::new(program);
    command.env("PATH", path).args(args);
    let output = command.output().map_err(|error| format!("{program}: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned());
    }
    Err(format!("{program}: {}", String::from_utf8_lossy(&output.stderr).trim()))
}

fn need_root() -> Result<(), Unavailable> {
    if rustix::process::geteuid().is_root() { Ok(()) } else { Err(Unavailable("needs root".to_owned())) }
}

/// A mounted file system.
#[derive(Debug)]
pub struct Mount {
    folder: PathBuf,
}

impl Mount {
    fn new(args: &[&OsStr], folder: &Path) -> Result<Self, String> {
        fs::create_dir_all(folder).map_err(|error| error.to_string())?;
        run("mount", args.iter().copied().chain([folder.as_os_str()]))?;
        Ok(Self { folder: folder.to_path_buf() })
    }

    /// Where.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        if run("umount", [&self.folder]).is_err() {
            // A process that is just ending may still use it.
            let _ = run("umount", [OsStr::new("-l"), self.folder.as_os_str()]);
        }
    }
}

/// A file system in memory of this size.
///
/// # Errors
/// [`Unavailable`].
pub fn small_disk(folder: &Path, bytes: u64) -> Result<Mount, Unavailable> {
    need_root()?;
    let size = format!("size={bytes},mode=0700");
    let args = ["-t", "tmpfs", "-o", &size, "tmpfs"].map(OsStr::new);
    Mount::new(&args, folder).map_err(Unavailable)
}

#[derive(Debug)]
struct Loop {
    device: String,
}

impl Drop for Loop {
    fn drop(&mut self) {
        let _ = run("losetup", ["-d", &self.device]);
    }
}

/// A fresh file system on a loop device, whose power can be cut.
#[derive(Debug)]
pub struct CutDisk {
    // Unmounted before the device is detached.
    mount: Mount,
    device: Loop,
    image: PathBuf,
    folder: PathBuf,
}

impl CutDisk {
    /// Makes one in a folder.
    ///
    /// # Errors
    /// [`Unavailable`].
    ///
    /// # Panics
    /// If the folder cannot be written.
    pub fn new(folder: &Path) -> Result<Self, Unavailable> {
        need_root()?;
        let image = folder.join("disk.img");
        let file = fs::File::create(&image).expect("a file for the image");
        file.set_len(IMAGE_BYTES).expect("an empty image");
        drop(file);
        let quiet = ["-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0"].map(OsStr::new);
        run("mkfs.ext4", quiet.into_iter().chain([image.as_os_str()])).map_err(Unavailable)?;
        let attach = ["-f", "--show"].map(OsStr::new);
        let device = run("losetup", attach.into_iter().chain([image.as_os_str()])).map_err(Unavailable)?;
        let device = Loop { device };
        let mount = Mount::new(&[OsStr::new(&device.device)], &folder.join("disk")).map_err(Unavailable)?;
        Ok(Self { mount, device, image, folder: folder.to_path_buf() })
    }

    /// The folder where the disk is mounted.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.mount.folder()
    }

    /// Blocks written so far, as the kernel counts.
    fn writes(&self) -> String {
        let name = self.device.device.trim_start_matches("/dev/");
        let stat = fs::read_to_string(format!("/sys/block/{name}/stat")).expect("the kernel counts writes");
        stat.split_whitespace().nth(4).expect("a fifth number").to_owned()
    }

    /// The disk after a power cut at this moment: a copy of the blocks written so far, mounted as after a
    /// crash. The writing processes must have been stopped. `None`: blocks were still written during the copy.
    ///
    /// # Panics
    /// If the copy cannot be made or mounted.
    #[must_use]
    pub fn cut(&self) -> Option<Mount> {
        let copy = self.folder.join("cut.img");
        let before = self.writes();
        run("cp", [OsStr::new("--sparse=always"), self.image.as_os_str(), copy.as_os_str()]).expect("room for a copy");
        if self.writes() != before {
            return None;
        }
        let args = [OsStr::new("-o"), OsStr::new("loop"), copy.as_os_str()];
        Some(Mount::new(&args, &self.folder.join("cut")).expect("a crashed file system is mounted"))
    }
}

/// Copies a folder with its content.
///
/// # Panics
/// If it cannot be copied.
pub fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder can be created");
    for entry in fs::read_dir(from).expect("a folder can be read") {
        let entry = entry.expect("an entry");
        let target = to.join(entry.file_name());
        if entry.file_type().expect("a type").is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), &target).expect("a file can be copied");
        }
    }
}

/// All files below a folder, relative to it, sorted.
///
/// # Panics
/// If it cannot be read.
#[must_use]
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).expect("a folder can be read") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path.strip_prefix(folder).expect("below the folder").to_path_buf());
            }
        }
    }
    found.sort();
    found
}

/// Every file below a folder with the checksum of its content and the time of its last change.
///
/// # Panics
/// If it cannot be read.
#[must_use]
pub fn contents(folder: &Path) -> Vec<(PathBuf, u32, std::time::SystemTime)> {
    let content = |file: PathBuf| {
        let path = folder.join(&file);
        let crc = crc32c::crc32c(&fs::read(&path).expect("a file can be read"));
        let changed = fs::metadata(&path).and_then(|metadata| metadata.modified()).expect("a time of change");
        (file, crc, changed)
    };
    files(folder).into_iter().map(content).collect()
}
