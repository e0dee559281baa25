//! Maps that are made from a copy of another daemon's map: new maps, and maps that replace one of this daemon.
//!
//! Invariant: the replaced map serves requests until its copy is complete and durable. Its files are set aside.

use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_store::{CopyError, MapCopy};
use tokio::sync::oneshot;
use tracing::{error, warn};

use super::{Catalog, CatalogError, MapOrigin, ended};
use crate::ending::Ending;

impl Catalog {
    /// Holds a map of the cluster that was copied from another daemon.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn adopt_copy(&self, spec: MapSpec, uid: u64, copy: MapCopy) -> Result<(), CatalogError> {
        let this = self.clone();
        ended(tidemap_base::task::spawn(async move {
            let open = this.changing.lock().await;
            if !*open {
                return Err(CatalogError::Stopping);
            }
            this.check_new(&spec)?;
            this.add(spec, MapOrigin::Copied(Box::new(copy), uid)).await.map(drop)
        }))
        .await
    }

    /// Replaces an open map of the cluster by a copy.
    ///
    /// # Errors
    /// See [`CatalogError`]; the map is as it was, or set aside.
    pub async fn replace_by_copy(&self, name: MapName, uid: u64, copy: MapCopy) -> Result<(), CatalogError> {
        let this = self.clone();
        ended(tidemap_base::task::spawn(async move {
            let open = this.changing.lock().await;
            if !*open {
                return Err(CatalogError::Stopping);
            }
            let old = this.get(name.as_str())?;
            let Some(cluster) =
                this.context.cluster.as_ref().filter(|_| old.shared_uid == Some(uid) && old.id == copy.map())
            else {
                return Err(CatalogError::Unknown(name.as_str().to_owned()));
            };
            // The copy took a long time. This daemon may have begun to write the map meanwhile; from now on it does
            // not.
            cluster.set_candidacy(uid, None);
            let is_diverged = old.digest().is_some_and(|digest| digest.is_equal == Some(false));
            if cluster.copy_cause(uid, is_diverged).is_none() {
                return Err(CatalogError::NoCopyNeeded(name));
            }
            cluster.unshare_at(uid, copy.end()).await;
            old.stop(Ending::Replaced).await;
            let (sender, installed) = oneshot::channel();
            let fatal = this.context.fatal.clone();
            this.open_again(old, move |_| {
                let outcome = copy.install();
                match &outcome {
                    Ok((_, Some(aside))) => warn!(
                        map = %name, folder = %aside.display(),
                        "a copy from another daemon replaces the map. The folder that it had is set aside: remove it \
                         when nobody needs it"
                    ),
                    Ok((_, None)) => {}
                    Err(error @ CopyError::Unfinished(_)) => {
                        // The next start completes the replacement. Data that the map accepted until then would be
                        // lost.
                        let _ = fatal.send(format!("a copy of map {name} cannot be put in its place: {error}"));
                    }
                    // The existing map is opened.
                    Err(error) => error!(map = %name, %error, "a copy of the map cannot be put in its place"),
                }
                // The caller that ordered the copy may have gone.
                let _ = sender.send(outcome.map(drop));
                Ok(())
            })
            .await;
            Ok(installed.await.map_err(|_| CatalogError::Stopping)??)
        }))
        .await
    }
}
