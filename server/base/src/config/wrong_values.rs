//! Wrong values of settings: the message names the key that is wrong.
//!
//! Invariant: every key is tried, including those of new settings.

use super::{Flags, SECTIONS, Setting, tests::load};

/// The first key that a message names.
fn blamed<'a>(message: &str, keys: &[&'a str]) -> Option<&'a str> {
    let is_of_key = |character: char| character.is_ascii_alphanumeric() || "_.".contains(character);
    let mut words = message.split(|character| !is_of_key(character)).map(|word| word.trim_start_matches("default."));
    // A message names a part of a value after its key, as in `log_format.a`.
    let is_within =
        |word: &str, key: &str| word.strip_prefix(key).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
    words.find_map(|word| keys.iter().find(|key| is_within(word, key)).copied())
}

/// Wrong values of keys, beyond wrong types and numbers out of range.
const WRONG: &[(&str, &str)] = &[
    ("expect_store_id", "'mine'"),
    ("listen", "'here'"),
    ("listen", "'0.0.0.0:1'"),
    ("http_listen", "'here'"),
    ("http_listen", "'0.0.0.0:1'"),
    ("tls_certificate", "'c'"),
    ("tls_key", "'k'"),
    ("tls_client_ca", "'c'"),
    ("log_format", "'xml'"),
    ("otlp_endpoint", "'https://collector:4317'"),
    ("trace_ratio", "1.5"),
    ("max_buffer_bytes", "0"),
    ("max_buffer_bytes", "8192"),
    ("max_buffer_bytes", "5_000_000_000"),
    ("max_stream_buffer_bytes", "1_073_741_824"),
    ("instruction_set", "'sse2'"),
    ("backup_dir", "'saved'"),
    ("backup_every_secs", "60"),
    ("cluster.name", "'a b'"),
    ("cluster.member", "''"),
    ("cluster.servers", "[]"),
    ("cluster.advertise", "'a:1'"),
    ("cluster.advertise", "'https://a:1'"),
    ("cluster.tls_certificate", "'c'"),
    ("cluster.tls_key", "'k'"),
    ("cluster.replicas", "17"),
    ("cluster.engine_replicas", "2"),
    ("cluster.capacity", "1001"),
    ("cluster.lease_ms", "1"),
    ("cluster.heal_wait_secs", "3601"),
    ("cluster.max_staleness_ms", "1"),
    ("cluster.group_bytes", "1"),
    ("cluster.keep_log_mib", "0"),
];

#[test]
fn a_wrong_value_of_any_key_blames_this_key() {
    let needed = [("member", "'a'"), ("servers", "['nats://a:4222']")];
    let least: String = needed.iter().map(|(key, value)| format!("{key} = {value}\n")).collect();
    let section = load(&format!("[cluster]\n{least}"), Flags::default()).expect("valid").cluster;
    let fields = serde_json::to_value(section).expect("a section");
    let of_cluster: Vec<String> =
        fields.as_object().expect("fields").keys().map(|key| format!("cluster.{key}")).collect();
    let settings: Vec<&Setting> = SECTIONS.iter().flat_map(|(_, settings)| settings.iter()).collect();
    let keys: Vec<&str> =
        settings.iter().map(|setting| setting.key).chain(of_cluster.iter().map(String::as_str)).collect();
    assert!(keys.len() > 60, "{keys:?}");
    let mut wrong: Vec<(&str, String)> = WRONG.iter().map(|(key, value)| (*key, (*value).to_owned())).collect();
    wrong.extend(keys.iter().map(|key| (*key, "{ a = 1 }".to_owned())));
    for setting in &settings {
        let Some((min, max)) = setting.range else { continue };
        let below = min.checked_sub(1).map(|below| below.to_string());
        wrong.extend(below.into_iter().chain([(max + 1).to_string()]).map(|value| (setting.key, value)));
    }
    for (key, value) in wrong {
        let file = match key.strip_prefix("cluster.") {
            None => format!("{key} = {value}"),
            Some(field) => {
                let others = needed.iter().filter(|(other, _)| *other != field);
                let others: String = others.map(|(other, value)| format!("{other} = {value}\n")).collect();
                format!("[cluster]\n{others}{field} = {value}")
            }
        };
        let error = load(&file, Flags::default()).expect_err(&file);
        assert_eq!(blamed(&error, &keys), Some(key), "{file}\n{error}");
    }
}
