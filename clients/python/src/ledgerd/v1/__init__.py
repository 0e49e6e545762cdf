"""The messages of the API, generated from crates/api/proto by clients/python/generate. Do not change them here."""
