//! How little memory a node that has started keeps resident.

#![expect(unsafe_code, reason = "no safe way to tell the kernel what is not needed")]

use std::ffi::c_void;

use rustix::mm::{Advice, madvise};

/// Gives back the pages of code that this process has mapped: what is run again comes again from the page cache, a fraction of a
/// microsecond each, and what only the start needed does not. Most of what a node has resident is such pages.
pub fn give_back_code() {
    let Ok(maps) = std::fs::read_to_string("/proc/self/maps") else { return };
    for (start, end) in maps.lines().filter_map(code_of_a_file) {
        // SAFETY: a private mapping of a file that cannot be written to: its pages are those of the file, now and when they come again.
        let advised = unsafe { madvise(start as *mut c_void, end - start, Advice::LinuxDontNeed) };
        if let Err(error) = advised {
            log::debug!("pages of code stay resident: {error}");
        }
    }
}

/// Where a line of `/proc/self/maps` has code of a file, if it does.
fn code_of_a_file(line: &str) -> Option<(usize, usize)> {
    let mut fields = line.split_ascii_whitespace();
    let (start, end) = fields.next()?.split_once('-')?;
    let (access, _offset, _device, inode) = (fields.next()?, fields.next()?, fields.next()?, fields.next()?);
    if access != "r-xp" || inode == "0" {
        return None;
    }
    Some((usize::from_str_radix(start, 16).ok()?, usize::from_str_radix(end, 16).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_code_of_files_is_given_back() {
        let code = "55d14e571000-55d14ee86000 r-xp 001ef000 fe:00 1837 /opt/rangehound";
        assert_eq!(code_of_a_file(code), Some((0x55d1_4e57_1000, 0x55d1_4ee8_6000)));
        for other in [
            "55d14ee86000-55d14eeb8000 r--p 00b03000 fe:00 1837 /opt/rangehound",
            "55d14eeb8000-55d14eebb000 rw-p 00b35000 fe:00 1837 /opt/rangehound",
            "55d14e571000-55d14ee86000 rwxp 001ef000 fe:00 1837 /opt/rangehound",
            "7f99a47ca000-7f99a47cc000 r-xp 00000000 00:00 0 [vdso]",
            "",
        ] {
            assert_eq!(code_of_a_file(other), None, "{other}");
        }
    }

    #[test]
    fn code_runs_on_after_its_pages_are_given_back() {
        give_back_code();
        assert_eq!("a b".split(' ').map(str::len).sum::<usize>(), 2);
    }
}
