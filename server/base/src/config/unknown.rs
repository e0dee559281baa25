//! Names that are no settings: keys of the config file, which are refused, and variables of the environment, which may
//! be another program's.
//!
//! Invariant: a message names the key as the user wrote it, and the setting that is most like it.

use figment::error::Kind;

use super::SECTIONS;

/// The similarity (Jaro and Winkler, 0 to 1) from which one name may be a misspelling of another one.
const ALIKE: f64 = 0.9;

/// Variables of the clients, without the prefix.
const OF_CLIENTS: [&str; 7] = ["server", "token", "token_file", "password", "tls_ca", "tls_cert", "tls_key"];

/// The known name that is most similar to a name, if one is similar enough.
fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let alike = known.map(|known| (strsim::jaro_winkler(name, known), known));
    alike.filter(|(alike, _)| *alike >= ALIKE).max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, known)| known)
}

fn keys() -> impl Iterator<Item = &'static str> {
    SECTIONS.iter().flat_map(|(_, settings)| settings.iter()).map(|setting| setting.key)
}

/// The text of an error of the sources of the settings.
pub(super) fn in_words(error: figment::Error) -> anyhow::Error {
    let Kind::UnknownField(found, fields) = &error.kind else { return anyhow::Error::new(error).context("settings") };
    let source = error.metadata.as_ref().and_then(|metadata| metadata.source.as_ref());
    let place = source.map_or_else(String::new, |source| format!("{source}: "));
    // The last part of the path is the key itself.
    let sections = error.path.split_last().map_or(&[][..], |(_, sections)| sections);
    let section: String = sections.iter().filter(|part| *part != "default").map(|part| format!("{part}.")).collect();
    let meant = nearest(found, fields.iter().copied());
    let meant = meant.map_or_else(String::new, |meant| format!("did you mean {section}{meant}? "));
    anyhow::anyhow!("{place}there is no setting {section}{found}: {meant}tidemapd config --example shows all settings")
}

/// A warning for each variable that is not a setting and is similar to one.
pub fn variables(names: impl Iterator<Item = String>) -> Vec<String> {
    let known = || keys().chain(["config", "cluster_member", "cluster_advertise", "cluster_servers"]);
    let warning = |name: String| {
        let key = name.strip_prefix("TIDEMAP_")?.to_ascii_lowercase();
        if known().any(|known| known == key) || OF_CLIENTS.contains(&key.as_str()) {
            return None;
        }
        let meant = nearest(&key, known())?.to_ascii_uppercase();
        Some(format!("the environment variable {name} is not a setting and is ignored: did you mean TIDEMAP_{meant}?"))
    };
    names.filter_map(warning).collect()
}

#[cfg(test)]
mod tests {
    use super::{super::tests::load, *};
    use crate::config::Flags;

    fn refused(file: &str) -> String {
        load(file, Flags::default()).expect_err(file)
    }

    #[test]
    fn an_unknown_key_is_named_with_the_one_that_is_like_it() {
        let error = refused("tls_cert = 'a'");
        assert!(error.contains("there is no setting tls_cert: did you mean tls_certificate?"), "{error}");
        assert!(error.contains(".toml"), "the file is named: {error}");
        let error = refused("colour = 'a'");
        assert!(error.contains("there is no setting colour") && !error.contains("did you mean"), "{error}");
        let error = refused("[cluster]\nmember = 'a'\nservers = ['nats://a:4222']\nreplica = 3");
        assert!(error.contains("no setting cluster.replica: did you mean cluster.replicas?"), "{error}");
    }

    #[test]
    fn a_variable_that_is_almost_a_setting_is_reported() {
        let warned = |name: &str| variables(std::iter::once(name.to_owned()));
        assert_eq!(
            warned("TIDEMAP_MAX_SATES_PER_MAP"),
            ["the environment variable TIDEMAP_MAX_SATES_PER_MAP is not a setting and is ignored: did you mean \
              TIDEMAP_MAX_STATES_PER_MAP?"]
        );
        assert_eq!(warned("TIDEMAP_MAX_STATES").len(), 1);
        // These are settings, variables of clients, and variables that Kubernetes sets for a service with the name
        // tidemap.
        let known = ["TIDEMAP_MAX_MAPS", "TIDEMAP_CONFIG", "TIDEMAP_SERVER", "TIDEMAP_TOKEN_FILE", "TIDEMAP_TLS_CERT"];
        let of_kubernetes = ["TIDEMAP_SERVICE_HOST", "TIDEMAP_PORT_7435_TCP_ADDR", "TIDEMAP_SERVICE_PORT_GRPC"];
        for name in known.into_iter().chain(of_kubernetes).chain(["HOME"]) {
            assert_eq!(warned(name), Vec::<String>::new());
        }
    }
}
