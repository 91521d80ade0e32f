//! What the operating system knows about this process and machine, and how it treats it: CPU time, memory, limits. libc.

fn usage() -> libc::rusage {
    // SAFETY: `rusage` is plain numbers, for which all-zero bytes are a value; getrusage writes into memory that is
    // ours and as large as it expects, and cannot fail for RUSAGE_SELF with a valid pointer.
    unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &mut usage);
        usage
    }
}

fn seconds(time: libc::timeval) -> f64 {
    time.tv_sec as f64 + time.tv_usec as f64 * 1e-6
}

/// User and system CPU seconds of this process so far, all threads together.
pub fn cpu_time_s() -> f64 {
    let usage = usage();
    seconds(usage.ru_utime) + seconds(usage.ru_stime)
}

/// Highest resident memory of this process so far, in MiB.
pub fn peak_memory_mib() -> f64 {
    usage().ru_maxrss as f64 / 1024.0
}

/// Physical memory of the machine in MiB; 0 when the system does not say.
pub fn memory_mib() -> f64 {
    // SAFETY: sysconf takes a number and returns a number; -1, where it does not know, is handled below.
    let (pages, page_bytes) = unsafe { (libc::sysconf(libc::_SC_PHYS_PAGES), libc::sysconf(libc::_SC_PAGESIZE)) };
    if pages < 0 || page_bytes < 0 { 0.0 } else { pages as f64 * page_bytes as f64 / (1024.0 * 1024.0) }
}

/// Makes a write beyond the limit of file sizes (`ulimit -f`) fail with an error, where a signal would end the process
/// without a word.
pub fn report_file_size_limit() {
    // SAFETY: no handler is installed that could run at a bad time: the signal is ignored, and the write returns EFBIG.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

/// Whether whoever started this process had it ignore that its terminal hangs up, as `nohup` does.
pub fn hang_up_is_ignored() -> bool {
    // SAFETY: `sigaction` is plain numbers and a null handler, for which all-zero bytes are a value; without a new action
    // the call only writes the present one into memory that is ours.
    unsafe {
        let mut present: libc::sigaction = std::mem::zeroed();
        libc::sigaction(libc::SIGHUP, std::ptr::null(), &mut present) == 0 && present.sa_sigaction == libc::SIG_IGN
    }
}

/// Ignores it, whatever was to be done before.
pub fn ignore_hang_up() {
    // SAFETY: no handler is installed that could run at a bad time: the signal is ignored.
    unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
}

/// Resizes a table to `n` entries, on huge pages where it grows large: the first touch of 10 MB in small pages takes as
/// long as a rendering.
pub fn grow<T: Clone + Default>(table: &mut Vec<T>, n: usize) {
    // Bytes of a huge page on x86-64.
    const HUGE: usize = 2 << 20;
    if table.capacity() < n {
        *table = Vec::new();
        table.reserve_exact(n + n / 8);
        let (start, bytes) = (table.as_ptr() as usize, table.capacity() * size_of::<T>());
        let (first, last) = (start.next_multiple_of(HUGE), (start + bytes) / HUGE * HUGE);
        if last > first {
            // SAFETY: the range lies within an allocation of ours; MADV_HUGEPAGE is advice on how to map it and leaves
            // its content as it is. Refused advice changes nothing.
            unsafe { libc::madvise(first as *mut libc::c_void, last - first, libc::MADV_HUGEPAGE) };
        }
    }
    table.resize(n, T::default());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_grow() {
        let mut table = vec![7u64; 3];
        grow(&mut table, 1 << 20);
        assert!(table.len() == 1 << 20 && table[100..].iter().all(|&v| v == 0));
        grow(&mut table, 5);
        assert_eq!(table.len(), 5);
    }

    #[test]
    fn figures_are_those_of_a_real_machine() {
        let before = cpu_time_s();
        let mut x = 0u64;
        while cpu_time_s() - before < 0.01 {
            x = std::hint::black_box(x + 1);
        }
        assert!(cpu_time_s() < 1e6 && x > 0);
        assert!(memory_mib() > 256.0);
        assert!(peak_memory_mib() > 0.5 && peak_memory_mib() < memory_mib());
    }
}
