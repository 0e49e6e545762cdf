//! Tmp.
use ledgerd_sim::{people::People, run::run};
use std::sync::Arc;
fn main() {
    let a: Vec<u64> = std::env::args().skip(1).map(|a| a.parse().unwrap()).collect();
    let people = Arc::new(People::new());
    let mut total = ledgerd_sim::coverage::Coverage::default();
    let start = std::time::Instant::now();
    for seed in a[0]..a[1] {
        let t = std::time::Instant::now();
        let report = run(seed, &people, a.len() > 2);
        total.add(&report.coverage);
        if let Some(text) = &report.trace { println!("{text}"); }
        if let Some(v) = &report.violation { println!("seed {seed}: {v}"); }
        if a.len() > 2 {println!("seed {seed} {:x} {:?}", report.trace_hash, t.elapsed());}
    }
    println!("{total}\n{:?}", start.elapsed());
}
