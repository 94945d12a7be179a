//! A long run of the closed loop costs no more per tick than a short one, in time and in memory.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::{Duration, Instant};

use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator, counting what this thread asks of it.
struct Counting;

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promises are those of the system's allocator.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(place, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn running(name: &str) -> ClosedLoop {
    let rig = Rig::named(name).unwrap();
    let mut stage = ClosedLoop::new(&rig, &controller_settings(&rig), Options::default()).unwrap();
    stage.arm().unwrap();
    let sine = GeneratorSettings::Sine(Wave::between(2.0, 12.0, 10.0));
    stage.start(&[(0, sine), (1, sine), (2, sine)]).unwrap();
    stage
}

fn time(stage: &mut ClosedLoop) -> Duration {
    let start = Instant::now();
    stage.run(2_000, |_| {});
    start.elapsed()
}

#[test]
fn no_tick_takes_memory() {
    for name in ["handley", "different"] {
        let mut stage = running(name);
        stage.run(2_000, |_| {});
        let before = ALLOCATIONS.get();
        stage.run(20_000, |_| {});
        assert_eq!(ALLOCATIONS.get() - before, 0, "{name}");
        // The counter does count.
        drop(std::hint::black_box(Box::new(before)));
        assert_eq!(ALLOCATIONS.get() - before, 1);
    }
}

#[test]
fn a_tick_takes_no_longer_after_a_hundred_seconds() {
    let (mut early, mut late) = (running("handley"), running("handley"));
    late.run(1_000_000, |_| {});
    // By turns, and the quickest of each: other programs only add to it.
    let (mut early_s, mut late_s) = (Duration::MAX, Duration::MAX);
    for _ in 0..40 {
        early_s = early_s.min(time(&mut early));
        late_s = late_s.min(time(&mut late));
    }
    let ratio = late_s.as_secs_f64() / early_s.as_secs_f64();
    assert!((0.67..1.5).contains(&ratio), "{late_s:?} after 100 s, {early_s:?} at first");
}
