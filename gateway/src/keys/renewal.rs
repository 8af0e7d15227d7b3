//! Keys that are replaced while a program runs.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::files::{AUTHORITY_CERTIFICATE, HOST_CERTIFICATE, HOST_KEY};

/// A value that is made of the keys in a folder. It is made again when their files change.
#[derive(Debug)]
pub(crate) struct Reloaded<T, F> {
    folder: Option<PathBuf>,
    make: F,
    made: T,
    seen: Seen,
}

/// Time of change, s and ns, and inode of each file; `None` if it is not there.
type Seen = [Option<(i64, i64, u64)>; 3];

impl<T, E: std::fmt::Display, F: Fn(Option<&Path>) -> Result<T, E>> Reloaded<T, F> {
    /// Makes it of the keys in this folder, or without any.
    ///
    /// # Errors
    /// Those of `make`.
    pub(crate) fn new(folder: Option<PathBuf>, make: F) -> Result<Self, E> {
        let seen = look(folder.as_deref());
        Ok(Self { made: make(folder.as_deref())?, seen, folder, make })
    }

    /// The value made of the present files. If they cannot be used, one line says so, and the previous value stays.
    pub(crate) fn present(&mut self) -> &T {
        let seen = look(self.folder.as_deref());
        if seen != self.seen {
            self.seen = seen;
            match (self.make)(self.folder.as_deref()) {
                Ok(made) => {
                    self.made = made;
                    log::info!("--keys has changed: its new keys are used from now on");
                }
                Err(error) => log::warn!("--keys has changed, but cannot be used: {error}; the old keys stay in use"),
            }
        }
        &self.made
    }
}

fn look(folder: Option<&Path>) -> Seen {
    [AUTHORITY_CERTIFICATE, HOST_CERTIFICATE, HOST_KEY].map(|name| {
        let file = std::fs::metadata(folder?.join(name)).ok()?;
        Some((file.ctime(), file.ctime_nsec(), file.ino()))
    })
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn a_configuration_is_made_again_once_for_each_change_of_the_keys_and_kept_if_they_are_bad() {
        let place = tempfile::TempDir::new().unwrap();
        let certificate = place.path().join(HOST_CERTIFICATE);
        let made = Cell::new(0);
        let make = |folder: Option<&Path>| {
            made.set(made.get() + 1);
            std::fs::read_to_string(folder.unwrap().join(HOST_CERTIFICATE)).map_err(|error| error.to_string())
        };
        assert!(Reloaded::new(Some(place.path().to_owned()), make).is_err());
        std::fs::write(&certificate, "first").unwrap();
        let mut renewed = Reloaded::new(Some(place.path().to_owned()), make).unwrap();
        assert_eq!((renewed.present().as_str(), made.get()), ("first", 2));
        std::fs::remove_file(&certificate).unwrap();
        assert_eq!((renewed.present().as_str(), made.get()), ("first", 3));
        assert_eq!((renewed.present().as_str(), made.get()), ("first", 3), "what has not changed is not read again");
        std::fs::write(&certificate, "second").unwrap();
        assert_eq!((renewed.present().as_str(), made.get()), ("second", 4));
        let other = place.path().join("other");
        std::fs::write(&other, "third").unwrap();
        std::fs::rename(&other, &certificate).unwrap();
        assert_eq!((renewed.present().as_str(), made.get()), ("third", 5));
    }

    #[test]
    fn without_a_folder_it_is_made_once() {
        let mut renewed = Reloaded::new(None, |_| Ok::<_, String>(())).unwrap();
        renewed.present();
        assert_eq!(renewed.seen, [None; 3]);
    }
}
