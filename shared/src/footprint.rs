//! How little memory a node that has started keeps resident.

#![expect(unsafe_code, reason = "no safe way to tell the kernel what is not needed")]

use std::ffi::c_void;
use std::ops::Range;

use rustix::mm::{Advice, madvise};

/// Gives back the pages of code that this process has mapped: what is run again comes again from the page cache, a fraction of a
/// microsecond each, and what only the start needed does not. Most of what a node has resident is such pages. Does nothing in a process that has
/// more than one thread, and leaves code alone that is not as in its file, as a debugger's is.
pub fn give_back_code() {
    let is_alone = std::fs::read_dir("/proc/self/task").is_ok_and(|threads| threads.count() == 1);
    let Ok(mappings) = std::fs::read("/proc/self/smaps") else { return };
    if !is_alone {
        return;
    }
    for code in code_as_in_files(&String::from_utf8_lossy(&mappings)) {
        // SAFETY: a private mapping of a file, of which no page is this process's own and which it cannot write to: its pages are those of the
        // file, now and when they come again. It is still there, as there is no other thread that could have unmapped it.
        let advised = unsafe { madvise(code.start as *mut c_void, code.len(), Advice::LinuxDontNeed) };
        if let Err(error) = advised {
            log::debug!("pages of code stay resident: {error}");
        }
    }
}

/// Where a text as of `/proc/self/smaps` has code of files of which no page has been changed, written out or not.
fn code_as_in_files(mappings: &str) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut code = None;
    for line in mappings.lines() {
        match line.split_once(':') {
            Some(("Anonymous" | "Swap", size)) if size.trim() != "0 kB" => code = None,
            // The last line of each mapping.
            Some(("VmFlags", _)) => found.extend(code.take()),
            _ => code = code_of_a_file(line).or(code),
        }
    }
    found
}

/// Where the first line of a mapping has code of a file, if it does.
fn code_of_a_file(line: &str) -> Option<Range<usize>> {
    let mut fields = line.split_ascii_whitespace();
    let (start, end) = fields.next()?.split_once('-')?;
    let (access, _offset, _device, inode) = (fields.next()?, fields.next()?, fields.next()?, fields.next()?);
    if access != "r-xp" || inode == "0" {
        return None;
    }
    Some(usize::from_str_radix(start, 16).ok()?..usize::from_str_radix(end, 16).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mapping(first: &str, anonymous_kb: u32, swap_kb: u32) -> String {
        format!(
            "{first}\nSize: 64 kB\nRss: 64 kB\nAnonymous: {anonymous_kb:8} kB\nSwap: {swap_kb:8} kB\nVmFlags: rd ex mr mw me\n"
        )
    }

    #[test]
    fn only_unchanged_code_of_files_is_given_back() {
        let code = "55d14e571000-55d14ee86000 r-xp 001ef000 fe:00 1837 /opt/range: hound";
        let found = |text: &str| code_as_in_files(text);
        let unchanged = 0x55d1_4e57_1000..0x55d1_4ee8_6000;
        assert_eq!(found(&mapping(code, 0, 0)), std::slice::from_ref(&unchanged));
        let others: String = [
            "55d14ee86000-55d14eeb8000 r--p 00b03000 fe:00 1837 /opt/rangehound",
            "55d14eeb8000-55d14eebb000 rw-p 00b35000 fe:00 1837 /opt/rangehound",
            "55d14e571000-55d14ee86000 rwxp 001ef000 fe:00 1837 /opt/rangehound",
            "7f99a47ca000-7f99a47cc000 r-xp 00000000 00:00 0 [vdso]",
            "",
        ]
        .iter()
        .map(|first| mapping(first, 0, 0))
        .collect();
        assert_eq!(found(&others), []);
        // A breakpoint's page is the process's own; it may have been written out.
        let changed = mapping(code, 4, 0) + &mapping(code, 0, 4);
        assert_eq!(found(&(changed.clone() + &others)), []);
        assert_eq!(found(&(changed + &mapping(code, 0, 0) + &others)), [unchanged]);
    }
}
