//! A map or a mask at a time as PGM and YAML, for Nav2's map server.
//!
//! Invariant: the image is in place before the YAML file that names it.

use tidemap_formats::{
    MapPicture, PictureCell,
    nav2::{self, GridMode, Thresholds},
};

use super::{
    super::{
        Session, files,
        grid::ever_occupied::{FileEverOccupied, ShownAs},
    },
    ExportArgs, Written,
    args::Mask,
    frames,
};
use crate::progress::status_line;

/// From this probability on a cell of a keepout mask is forbidden, because map servers read such a cell as occupied.
const OCCUPIED: f64 = 0.65;
/// The lowest limit of a speed mask, as a share of the greatest speed.
const SLOWEST: f64 = 0.2;

pub(super) async fn write(session: &Session, args: &ExportArgs, time_nanos: i64) -> anyhow::Result<Vec<Written>> {
    let grid = frames::grid(session, &args.options(), time_nanos).await?;
    let image_path = args.path.with_extension("pgm");
    let thresholds = Thresholds::default();
    let (picture, mode, content, ever_occupied) = match args.mask {
        None => {
            let occupied = nav2::in_map(&grid.picture, thresholds);
            (
                grid.picture,
                GridMode::Trinary,
                "map",
                Some(FileEverOccupied { occupied, kind: ShownAs::Map(thresholds) }),
            )
        }
        Some(Mask::Keepout) => {
            let areas = frames::areas(session, &args.map).await?;
            let (names, corners): (Vec<_>, Vec<_>) = areas.into_iter().unzip();
            for (name, corners) in names.iter().zip(&corners) {
                if !corners.iter().all(|corner| is_within(&grid.picture, *corner)) {
                    status_line(&format!("no-go area {name} reaches beyond the map: that part is not in the mask"));
                }
            }
            let occupied_from = args.occupied.unwrap_or(OCCUPIED);
            let mask = nav2::keepout(&grid.picture, &corners, occupied_from)?;
            let occupied = nav2::in_keepout(&grid.picture, &mask);
            let occupied = FileEverOccupied { occupied, kind: ShownAs::Keepout(occupied_from) };
            (mask, GridMode::Trinary, "keepout", Some(occupied))
        }
        Some(Mask::Speed) => {
            (nav2::speed(&grid.picture, args.slowest.unwrap_or(SLOWEST))?, GridMode::Raw, "speed", None)
        }
    };
    let name = image_path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let map = nav2::write(&picture, &name, mode, thresholds)?;
    files::replace(&image_path, &map.image)?;
    files::replace(&args.path, &map.yaml)?;
    let known = picture.cells.iter().filter(|cell| **cell != PictureCell::Unknown).count() as u64;
    Ok(vec![Written { path: args.path.display().to_string(), content, count: known, ever_occupied }])
}

/// Whether a place is on a map.
fn is_within(picture: &MapPicture, at_m: [f64; 2]) -> bool {
    (0..2).all(|axis| {
        let cells = (at_m[axis] - picture.origin_m[axis]) / picture.resolution_m;
        (0.0..=f64::from(picture.size_cells[axis])).contains(&cells)
    })
}
