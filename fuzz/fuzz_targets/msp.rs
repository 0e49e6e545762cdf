//! An MSP directory is refused with its fault, or its authorities are those of an organisation.
//!
//! The bytes: files, each with its kind (u8), the length of its content (u16) and the content. With the highest bit of the kind the
//! content is written as PEM.
#![no_main]

use fabric::MspDirectory;
use ledger_fuzz::files::{self, File};
use ledger_identity::msp::{Msp, Msps, Usage};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let directory = files::write(&File::all(bytes));
    if let Ok(read) = MspDirectory::read(directory.path(), "Org3", 0) {
        let msp = Msp::new("Org3", &read.roots, &read.intermediates).expect("the ledger takes them too");
        assert!(read.lists.iter().all(|list| msp.verify_list(list).is_ok()));
        // Hostile authorities in the place of a person, and on the way from one: no authority is a person.
        let mut msps = Msps::new();
        msps.insert(msp).expect("it is the only one");
        let mut all = read.roots.iter().chain(&read.intermediates);
        assert!(all.all(|der| msps.verify_for(Usage::Client, der, &[], 0).is_err()));
    }
});
