//! Names the system limit behind a refusal: its value, and how to raise it.
//!
//! The system itself only says "Resource temporarily unavailable" or "Cannot allocate memory".

use std::path::{Path, PathBuf};

use rustix::io::Errno;
use rustix::process::{Resource, getrlimit, getuid};

/// Margin within which a count is taken to have reached its limit: it may have changed since the refusal.
const NEAR: u64 = 2;

const PROC: &str = "/proc";
const CGROUPS: &str = "/sys/fs/cgroup";

/// Explains a refusal of the system, as far as its error allows.
#[must_use]
pub fn explain(error: &std::io::Error) -> Option<String> {
    match Errno::from_io_error(error)? {
        Errno::AGAIN => Some(processes()),
        Errno::MFILE => {
            let limit = getrlimit(Resource::Nofile).current.map_or("no".to_owned(), |limit| limit.to_string());
            Some(format!("this process may have {limit} files open: raise the limit, with ulimit -n"))
        }
        Errno::NFILE => {
            let limit = number(&Path::new(PROC).join("sys/fs/file-max"));
            let limit = limit.map_or(String::new(), |limit| format!(" {limit}"));
            Some(format!(
                "all processes together have reached the limit of{limit} open files (/proc/sys/fs/file-max): raise it, or end other programs"
            ))
        }
        Errno::NOMEM => Some(match getrlimit(Resource::As).current {
            Some(bytes) => format!("a process may have {} kB of memory: raise the limit, with ulimit -v", bytes >> 10),
            None => "the system has no memory left for it: end other programs, or take fewer robots".to_owned(),
        }),
        _ => None,
    }
}

/// Names the limit of processes and threads that was reached.
fn processes() -> String {
    let of_user = if getuid().is_root() { None } else { getrlimit(Resource::Nproc).current };
    let of_cgroup = cgroup_limits().min_by_key(|(_, limit, used)| limit.saturating_sub(*used));
    let of_system =
        ["threads-max", "pid_max"].map(|name| (name, number(&Path::new(PROC).join("sys/kernel").join(name))));
    let used = threads_of_system();
    let is_reached = |limit: u64, used: u64| used.saturating_add(NEAR) >= limit;
    if let Some((path, limit, used)) = &of_cgroup
        && is_reached(*limit, *used)
    {
        let path = path.display();
        return format!(
            "this container or service may have {limit} processes and threads ({path}): raise the limit (docker --pids-limit, systemd TasksMax), or take fewer robots"
        );
    }
    if let Some(limit) = of_user
        && is_reached(limit, threads_of_user())
    {
        return format!(
            "this user may have {limit} processes and threads: raise the limit, with ulimit -u, or take fewer robots"
        );
    }
    for (name, limit) in of_system {
        if let Some(limit) = limit.filter(|limit| used.is_some_and(|used| is_reached(*limit, used))) {
            return format!(
                "all users together may have {limit} processes and threads (/proc/sys/kernel/{name}): raise it, or end other programs"
            );
        }
    }
    let mut limits: Vec<String> = Vec::new();
    limits.extend(of_user.map(|limit| format!("ulimit -u is {limit}")));
    limits.extend(of_cgroup.map(|(path, limit, _)| format!("{} is {limit}", path.display())));
    limits.extend(of_system.into_iter().filter_map(|(name, limit)| Some(format!("{name} is {}", limit?))));
    format!("a limit of processes and threads has been reached ({}): raise it, or take fewer robots", limits.join(", "))
}

/// The limit file, limit and usage of each control group of this process.
fn cgroup_limits() -> impl Iterator<Item = (PathBuf, u64, u64)> {
    let groups = std::fs::read_to_string(Path::new(PROC).join("self/cgroup")).unwrap_or_default();
    let mut found = Vec::new();
    for line in groups.lines() {
        let mut fields = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (fields.next(), fields.next()) else { continue };
        let root = match controllers {
            "" => PathBuf::from(CGROUPS),
            "pids" => Path::new(CGROUPS).join("pids"),
            _ => continue,
        };
        // In a container the path may be the host's: its own group is then at the root.
        let own = root.join(path.trim_start_matches('/'));
        found.extend(own.ancestors().take_while(|group| group.starts_with(&root)).map(Path::to_owned));
    }
    found.into_iter().filter_map(|group| {
        let file = group.join("pids.max");
        let (limit, used) = (number(&file)?, number(&group.join("pids.current"))?);
        Some((file, limit, used))
    })
}

/// Threads of all processes of this user.
fn threads_of_user() -> u64 {
    let own = getuid().as_raw().to_string();
    let processes = std::fs::read_dir(PROC).into_iter().flatten().flatten();
    let threads = processes.filter_map(|process| {
        let status = std::fs::read_to_string(process.path().join("status")).ok()?;
        let field = |name: &str| status.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next();
        if field("Uid:") == Some(&own) { field("Threads:")?.parse::<u64>().ok() } else { None }
    });
    threads.sum()
}

/// Threads of all processes.
fn threads_of_system() -> Option<u64> {
    let load = std::fs::read_to_string(Path::new(PROC).join("loadavg")).ok()?;
    load.split(' ').nth(3)?.split_once('/')?.1.parse().ok()
}

fn number(file: &Path) -> Option<u64> {
    std::fs::read_to_string(file).ok()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_explanation_of_a_refusal_names_the_limit() {
        let explained = |errno: Errno| explain(&errno.into());
        for (errno, word) in [(Errno::AGAIN, "processes"), (Errno::MFILE, "ulimit -n"), (Errno::NFILE, "file-max")] {
            let text = explained(errno).unwrap();
            assert!(text.contains(word) && text.contains(|c: char| c.is_ascii_digit()), "{text}");
            assert!(!text.contains('\n'), "{text}");
        }
        assert!(explained(Errno::NOMEM).is_some());
        assert_eq!((explained(Errno::NOENT), explain(&std::io::Error::other("x"))), (None, None));
    }

    #[test]
    fn the_threads_of_this_user_are_counted() {
        let (release, wait) = std::sync::mpsc::channel::<()>();
        let wait = std::sync::Mutex::new(wait);
        std::thread::scope(|scope| {
            for _ in 0..20 {
                scope.spawn(|| wait.lock().map(|wait| wait.recv()).is_ok());
            }
            // This process alone has as many; others start and end meanwhile.
            assert!(threads_of_user() > 20 && threads_of_system().unwrap() > 20);
            drop(release);
        });
    }
}
