//! A disk in memory that knows what is durable and what is not.
//!
//! After a power cut each file is a random mixture, sector by sector, of its content at the last sync and since, with
//! any length in between. A folder keeps a random prefix of its changes of names since its last sync.

use std::{
    collections::BTreeMap,
    io::{self, Cursor, Read},
    path::{Component, Path},
    sync::{Arc, Mutex, MutexGuard},
};

use rand::{Rng as _, rngs::SmallRng};

use crate::disk::{Disk, DiskFile, DiskReader};

const SECTOR: usize = 512;

type Names = BTreeMap<String, usize>;

#[derive(Clone)]
enum DiskNode {
    /// The content at the last sync, and after each change since.
    File(Vec<Vec<u8>>),
    /// The names at the last sync, and after each change since.
    Folder(Vec<Names>),
}

/// The moment at which a call fails.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// The number of the call, from 0.
    pub call: usize,
    /// The error that it returns.
    pub kind: io::ErrorKind,
    /// Whether all later calls that can fail like this fail too.
    pub is_sticky: bool,
}

struct DiskState {
    nodes: Vec<DiskNode>,
    calls: usize,
    fault: Option<Fault>,
    random: SmallRng,
}

/// The disk; clones are the same disk.
#[derive(Clone)]
pub struct SimulatedDisk(Arc<Mutex<DiskState>>);

fn latest<T>(versions: &[T]) -> &T {
    versions.last().expect("never empty")
}

impl DiskState {
    /// Counts a call that changes the disk, and fails the one that was chosen.
    fn call(&mut self, may_be_full: bool) -> io::Result<()> {
        let call = self.calls;
        self.calls += 1;
        match self.fault {
            Some(fault)
                if (fault.call == call || fault.is_sticky && call > fault.call)
                    && (may_be_full || fault.kind != io::ErrorKind::StorageFull) =>
            {
                Err(fault.kind.into())
            }
            _ => Ok(()),
        }
    }

    fn find(&self, path: &Path) -> io::Result<usize> {
        let mut node = 0;
        for part in path.components() {
            let Component::Normal(name) = part else { continue };
            let name = name.to_str().expect("text");
            let DiskNode::Folder(versions) = &self.nodes[node] else { return Err(io::ErrorKind::NotADirectory.into()) };
            node = *latest(versions).get(name).ok_or(io::ErrorKind::NotFound)?;
        }
        Ok(node)
    }

    fn change_names(&mut self, folder: &Path, change: impl FnOnce(&mut Names)) -> io::Result<()> {
        let node = self.find(folder)?;
        let DiskNode::Folder(versions) = &mut self.nodes[node] else { return Err(io::ErrorKind::NotADirectory.into()) };
        let mut names = latest(versions).clone();
        change(&mut names);
        versions.push(names);
        Ok(())
    }

    fn add(&mut self, path: &Path, node: DiskNode) -> io::Result<usize> {
        self.nodes.push(node);
        let number = self.nodes.len() - 1;
        self.change_names(folder_of(path), |names| {
            names.insert(name_of(path), number);
        })?;
        Ok(number)
    }

    fn content(&mut self, node: usize) -> &mut Vec<Vec<u8>> {
        match &mut self.nodes[node] {
            DiskNode::File(versions) => versions,
            DiskNode::Folder(_) => panic!("a folder is no file"),
        }
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().expect("has a folder")
}

fn name_of(path: &Path) -> String {
    path.file_name().expect("has a name").to_str().expect("text").to_owned()
}

/// The bytes that a power cut leaves of a file.
fn torn(versions: &[Vec<u8>], random: &mut SmallRng) -> Vec<u8> {
    if versions.len() == 1 {
        return versions[0].clone();
    }
    let older = random.random_range(0..versions.len());
    let newer = random.random_range(older..versions.len());
    let (older, newer) = (&versions[older], &versions[newer]);
    let range = older.len().min(newer.len())..=older.len().max(newer.len());
    let length = if random.random() { newer.len() } else { random.random_range(range) };
    let mut content = vec![0; length];
    for start in (0..length).step_by(SECTOR) {
        let source = if random.random() { older } else { newer };
        let end = (start + SECTOR).min(length).min(source.len());
        if start < end {
            content[start..end].copy_from_slice(&source[start..end]);
        }
    }
    content
}

impl SimulatedDisk {
    /// An empty disk, whose losses follow from the random numbers.
    #[must_use]
    pub fn new(random: SmallRng) -> SimulatedDisk {
        let nodes = vec![DiskNode::Folder(vec![Names::new()])];
        SimulatedDisk(Arc::new(Mutex::new(DiskState { nodes, calls: 0, fault: None, random })))
    }

    fn state(&self) -> MutexGuard<'_, DiskState> {
        self.0.lock().expect("not poisoned")
    }

    /// Makes a call fail.
    ///
    /// # Panics
    /// Where another thread has panicked with the disk.
    pub fn set_fault(&self, fault: Option<Fault>) {
        self.state().fault = fault;
    }

    /// Calls so far that may fail.
    #[must_use]
    pub fn calls(&self) -> usize {
        self.state().calls
    }

    /// The disk as the machine finds it after a power cut. Handles of the old one do not reach it.
    #[must_use]
    pub fn power_cut(&self) -> SimulatedDisk {
        let mut state = self.state();
        let mut random = state.random.clone();
        let nodes = state.nodes.iter().map(|node| match node {
            DiskNode::File(versions) => DiskNode::File(vec![torn(versions, &mut random)]),
            DiskNode::Folder(versions) => {
                let kept = random.random_range(0..versions.len());
                DiskNode::Folder(vec![versions[kept].clone()])
            }
        });
        let nodes = nodes.collect();
        state.random = random.clone();
        SimulatedDisk(Arc::new(Mutex::new(DiskState { nodes, calls: 0, fault: None, random })))
    }

    /// The disk after the process was killed: nothing is lost, and nothing more is durable than before.
    #[must_use]
    pub fn kill(&self) -> SimulatedDisk {
        let state = self.state();
        let (nodes, random) = (state.nodes.clone(), state.random.clone());
        SimulatedDisk(Arc::new(Mutex::new(DiskState { nodes, calls: 0, fault: None, random })))
    }
}

impl Disk for SimulatedDisk {
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        let mut state = self.state();
        state.call(true)?;
        let node = match state.find(file) {
            Ok(node) => {
                state.content(node).push(Vec::new());
                node
            }
            Err(_) => state.add(file, DiskNode::File(vec![Vec::new()]))?,
        };
        Ok(Box::new(SimulatedFile { disk: self.clone(), node }))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        let node = self.state().find(file)?;
        Ok(Box::new(SimulatedFile { disk: self.clone(), node }))
    }

    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>> {
        let mut state = self.state();
        let node = state.find(file)?;
        Ok(Box::new(Cursor::new(latest(state.content(node)).clone())))
    }

    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>> {
        let node = self.state().find(file)?;
        Ok(Box::new(SimulatedFile { disk: self.clone(), node }))
    }

    fn length(&self, file: &Path) -> io::Result<u64> {
        let mut state = self.state();
        let node = state.find(file)?;
        Ok(latest(state.content(node)).len() as u64)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<String>> {
        let state = self.state();
        match &state.nodes[state.find(folder)?] {
            DiskNode::Folder(versions) => Ok(latest(versions).keys().cloned().collect()),
            DiskNode::File(_) => Err(io::ErrorKind::NotADirectory.into()),
        }
    }

    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.call(true)?;
        if state.find(folder).is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        state.add(folder, DiskNode::Folder(vec![Names::new()])).map(|_| ())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        assert_eq!(folder_of(from), folder_of(to), "renamed within one folder");
        let mut state = self.state();
        state.call(true)?;
        let node = state.find(from)?;
        state.change_names(folder_of(from), |names| {
            names.remove(&name_of(from));
            names.insert(name_of(to), node);
        })
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.call(false)?;
        state.find(file)?;
        state.change_names(folder_of(file), |names| {
            names.remove(&name_of(file));
        })
    }

    fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        self.remove(folder)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.call(false)?;
        let node = state.find(folder)?;
        if let DiskNode::Folder(versions) = &mut state.nodes[node] {
            versions.drain(..versions.len() - 1);
        }
        Ok(())
    }
}

struct SimulatedFile {
    disk: SimulatedDisk,
    node: usize,
}

impl DiskReader for SimulatedFile {
    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()> {
        let mut state = self.disk.state();
        let content = latest(state.content(self.node));
        let found = content.get(offset as usize..).and_then(|rest| rest.get(..bytes.len()));
        bytes.copy_from_slice(found.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
}

impl DiskFile for SimulatedFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut state = self.disk.state();
        let result = state.call(true);
        // A refused write may have written a part.
        let written = if result.is_ok() { bytes.len() } else { state.random.random_range(0..=bytes.len()) };
        let versions = state.content(self.node);
        let mut content = latest(versions).clone();
        content.extend_from_slice(&bytes[..written]);
        versions.push(content);
        result
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        let mut state = self.disk.state();
        state.call(false)?;
        let versions = state.content(self.node);
        let mut content = latest(versions).clone();
        content.resize(length as usize, 0);
        versions.push(content);
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        let mut state = self.disk.state();
        state.call(false)?;
        let versions = state.content(self.node);
        versions.drain(..versions.len() - 1);
        Ok(())
    }
}
