//! The command `keys`.

use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};

use super::files::{AUTHORITY_FOLDER, make_parents};
use super::{Authority, Host, HostKeys, HostName, HostRole, KeysError, RobotHost, Validity, make};

/// Longest validity, days: a hundred years.
const DAYS_MAX: i64 = 36_500;

/// Make keys for hosts: a folder for each, to be copied to it
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("made").args(["gateway", "hosts"]).required(true).multiple(true))]
pub struct KeysArgs {
    /// Folder for the keys. If it has an authority already, that one signs the new certificates
    #[arg(long, value_name = "DIR", default_value = "keys")]
    pub out: PathBuf,
    /// Host of the run, whose gateway the robots' hosts connect to
    #[arg(long, value_name = "NAME")]
    pub gateway: Option<HostName>,
    /// Host of robots, and the robots that it may speak for: alice=0,1 or bob=2-5 (may be repeated)
    #[arg(long = "host", value_name = "NAME=ROBOTS")]
    pub hosts: Vec<RobotHost>,
    /// Days until the certificates expire
    #[arg(long, value_name = "N", default_value_t = 365, allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(1..=DAYS_MAX))]
    pub days: u32,
}

impl KeysArgs {
    /// Makes the keys, and prints what to do with them.
    ///
    /// # Errors
    /// [`KeysError`]. No existing file is changed.
    pub fn carry_out(&self) -> Result<(), KeysError> {
        let authority_is_new = self.make()?;
        let mut stdout = std::io::stdout().lock();
        stdout
            .write_all(self.report(authority_is_new).as_bytes())
            .and_then(|()| stdout.flush())
            .map_err(KeysError::Print)
    }

    /// The hosts, the gateway first.
    fn all_hosts(&self) -> Vec<Host> {
        let gateway = self.gateway.iter().map(|name| Host { name: name.clone(), role: HostRole::Gateway });
        gateway.chain(self.hosts.iter().cloned().map(Host::from)).collect()
    }

    fn folder(&self, host: &Host) -> PathBuf {
        self.out.join(host.name.as_str())
    }

    /// Makes the keys; true if the authority is new.
    fn make(&self) -> Result<bool, KeysError> {
        let hosts = self.all_hosts();
        let mut names = HashSet::new();
        // Wrong hosts are refused before anything is written.
        for host in &hosts {
            if !names.insert(host.name.as_str()) {
                return Err(KeysError::Twice(host.name.as_str().to_owned()));
            }
            let folder = self.folder(host);
            if exists(&folder) {
                return Err(KeysError::Exists(folder));
            }
        }
        let authority_folder = self.out.join(AUTHORITY_FOLDER);
        let is_new = !exists(&authority_folder);
        let authority = if is_new { Authority::new()? } else { Authority::load(&authority_folder)? };
        let validity = Validity::of_days(self.days)?;
        let keys: Vec<HostKeys> =
            hosts.iter().map(|host| make(&authority, host, validity)).collect::<Result<_, _>>()?;

        make_parents(&self.out)?;
        if is_new {
            authority.save(&authority_folder)?;
        }
        hosts.iter().zip(&keys).try_for_each(|(host, keys)| keys.save(&self.folder(host)))?;
        Ok(is_new)
    }

    /// The files that were made, and the next steps of the user.
    fn report(&self, authority_is_new: bool) -> String {
        let hosts = self.all_hosts();
        let mut made = String::new();
        let mut next = String::new();
        if authority_is_new {
            let folder = self.out.join(AUTHORITY_FOLDER);
            made += &format!("{}: new authority; its key stays here; keep it secret\n", folder.display());
        }
        for host in &hosts {
            let folder = self.folder(host);
            let folder = folder.display();
            made += &format!("{folder}: {}, for {} days\n", host.role, self.days);
            next += &match host.role {
                HostRole::Gateway => format!("  rangehound run --listen ADDRESS --keys {folder}\n"),
                HostRole::Robots(robots) => format!(
                    "  copy {folder} to {name}, and there:\n    \
                     rangehound robot --id {first} --connect ADDRESS --keys {folder}\n",
                    name = host.name.as_str(),
                    first = robots.iter().next().unwrap_or_default(),
                ),
            };
        }
        format!("{made}Next:\n{next}")
    }
}

/// True if there is anything of this name, even a link to nothing.
fn exists(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use clap::Parser;
    use tempfile::TempDir;

    use super::*;
    use crate::keys::Credentials;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        keys: KeysArgs,
    }

    fn parsed(out: &Path, rest: &str) -> Result<KeysArgs, clap::Error> {
        let fixed = ["keys", "--out", out.to_str().unwrap()];
        Cli::try_parse_from(fixed.into_iter().chain(rest.split_whitespace())).map(|cli| cli.keys)
    }

    fn carry_out(out: &Path, rest: &str) -> Result<(), KeysError> {
        parsed(out, rest).unwrap().carry_out()
    }

    fn mode(path: &Path) -> u32 {
        path.metadata().unwrap().permissions().mode() & 0o777
    }

    fn read_all(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .flat_map(
                |path| if path.is_dir() { read_all(&path) } else { vec![(path.clone(), std::fs::read(path).unwrap())] },
            )
            .collect();
        files.sort();
        files
    }

    #[test]
    fn each_host_gets_its_keys_and_others_can_be_added() {
        let place = TempDir::new().unwrap();
        let out = place.path().join("new/keys");
        carry_out(&out, "--gateway station --host alice=0,1 --host bob=2-5").unwrap();

        for folder in ["", "authority", "station", "alice", "bob"] {
            assert_eq!(mode(&out.join(folder)), 0o700, "{folder}");
        }
        for (path, _) in read_all(&out) {
            let expected = if path.extension().unwrap() == "key" { 0o600 } else { 0o644 };
            assert_eq!(mode(&path), expected, "{}", path.display());
        }
        assert_eq!(read_all(&out).len(), 2 + 3 * 3);
        let station = Credentials::load(&out.join("station")).unwrap();
        assert!(station.own().is_gateway() && station.own().robots().is_empty());
        let alice = Credentials::load(&out.join("alice")).unwrap();
        assert_eq!(alice.own().host, "alice");
        assert!(alice.own().robots().iter().eq([0, 1]) && !alice.own().is_gateway());
        let bob = Credentials::load(&out.join("bob")).unwrap();
        assert!(bob.own().may_be(5) && !bob.own().may_be(1) && !bob.own().may_be(6));

        let before = read_all(&out);
        carry_out(&out, "--host carol=6").unwrap();
        let after = read_all(&out);
        assert!(before.iter().all(|file| after.contains(file)));
        assert_eq!(after.len(), before.len() + 3);
        let authority = |host: &str| std::fs::read(out.join(host).join("authority.pem")).unwrap();
        assert_eq!(authority("carol"), authority("alice"));
    }

    #[test]
    fn existing_files_are_never_replaced() {
        let place = TempDir::new().unwrap();
        let out = place.path().join("keys");
        carry_out(&out, "--host alice=0").unwrap();
        std::os::unix::fs::symlink("nowhere", out.join("link")).unwrap();
        let before = read_all(&out.join("alice"));
        for rest in ["--host alice=1", "--host bob=1 --host alice=2", "--host link=1", "--gateway alice"] {
            let refusal = carry_out(&out, rest).unwrap_err();
            assert!(matches!(refusal, KeysError::Exists(_)), "{rest}: {refusal}");
        }
        let refusal = carry_out(&out, "--host bob=1 --gateway bob").unwrap_err();
        assert!(refusal.to_string().starts_with("two hosts are named bob"), "{refusal}");
        assert_eq!(read_all(&out.join("alice")), before);
        assert!(!out.join("bob").exists());
    }

    #[test]
    fn a_damaged_authority_is_refused_in_one_line_and_kept() {
        let place = TempDir::new().unwrap();
        let out = place.path().join("keys");
        carry_out(&out, "--host alice=0").unwrap();
        let (certificate, key) = (out.join("authority/authority.pem"), out.join("authority/authority.key"));
        let damages: [(&Path, Option<&[u8]>); 7] = [
            (&certificate, None),
            (&key, None),
            (&certificate, Some(b"")),
            (&key, Some(b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n")),
            (&certificate, Some(b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")),
            (&certificate, Some(b"\xff\xfe")),
            (&key, Some(&std::fs::read(out.join("alice/host.key")).unwrap())),
        ];
        for (path, damage) in damages {
            let whole = std::fs::read(path).unwrap();
            match damage {
                Some(bytes) => std::fs::write(path, bytes).unwrap(),
                None => std::fs::remove_file(path).unwrap(),
            }
            let refusal = carry_out(&out, "--host bob=1").unwrap_err().to_string();
            assert!(refusal.contains("authority") && !refusal.contains('\n'), "{refusal}");
            assert!(!out.join("bob").exists());
            std::fs::write(path, whole).unwrap();
        }
        carry_out(&out, "--host bob=1").unwrap();
    }

    #[test]
    fn bad_usage_is_refused() {
        for rest in ["", "--days 3", "--host a=0 --days 0", "--host a=0 --days -1", "--gateway ../x", "--host a"] {
            assert!(parsed(Path::new("keys"), rest).is_err(), "{rest}");
        }
    }

    #[test]
    fn the_report_says_what_to_do_next_in_short_lines() {
        let args = parsed(Path::new("keys"), "--gateway station --host alice=0,1 --days 30").unwrap();
        let report = args.report(true);
        for line in [
            "keys/authority: new authority",
            "keys/alice: robots 0-1, for 30 days",
            "rangehound run --listen ADDRESS --keys keys/station",
            "copy keys/alice to alice",
            "rangehound robot --id 0 --connect ADDRESS --keys keys/alice",
        ] {
            assert!(report.contains(line), "{report}");
        }
        assert!(report.lines().all(|line| line.len() <= 80), "{report}");
    }
}
