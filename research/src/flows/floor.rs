//! The floor as a raster of cells, and as a lattice of nodes in the middles of the open ones.
//!
//! Invariant: an edge leads over open cells only.

use tidemap_map::{
    name::StateName,
    topology::{Edge, Extent, NodeId, NodePose, Topology},
};
use tidemap_model::models::FlowRaster;
use tidemap_sim::StreamOffice;

use super::FlowsError;

/// Speed of the robot, metres per second.
pub(super) const SPEED_M_PER_S: f64 = 0.8;
/// Length of a cell's edge, metres.
const CELL_M: f64 = 1.0;

/// The floor.
pub(super) struct Floor {
    raster: FlowRaster,
    topology: Topology,
    /// By cell; `None` inside walls.
    nodes: Vec<Option<NodeId>>,
}

impl Floor {
    pub(super) fn new() -> Result<Floor, FlowsError> {
        let counts = StreamOffice::SIZE_M.map(|size| (size / CELL_M) as usize);
        let raster = FlowRaster { low_m: [0.0, 0.0], edge_m: CELL_M, counts };
        let mut floor = Floor { raster, topology: Topology::new(), nodes: vec![None; raster.cells()] };
        let inconsistent = |error: &dyn std::fmt::Display| FlowsError::Setting(error.to_string());
        for cell in 0..raster.cells() {
            let [x_m, y_m] = raster.middle_m(cell);
            if StreamOffice::is_open([x_m, y_m]) {
                let name = StateName::new(&format!("n{cell}")).map_err(|error| inconsistent(&error))?;
                let pose = Some(NodePose { x_m, y_m, yaw_rad: 0.0 });
                floor.nodes[cell] =
                    Some(floor.topology.add_node(name, pose, None).map_err(|error| inconsistent(&error))?);
            }
        }
        for cell in 0..raster.cells() {
            for (other, length_m) in floor.neighbours(cell) {
                if let (Some(from), Some(to)) = (floor.nodes[cell], floor.nodes[other]) {
                    let extent = Extent::metres(length_m);
                    floor.topology.add_edge(from, to, None, extent).map_err(|error| inconsistent(&error))?;
                }
            }
        }
        Ok(floor)
    }

    pub(super) fn raster(&self) -> FlowRaster {
        self.raster
    }

    pub(super) fn topology(&self) -> &Topology {
        &self.topology
    }

    /// The indices of the open cells.
    pub(super) fn open_cells(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.nodes.len()).filter(|&cell| self.nodes[cell].is_some())
    }

    /// The node of the cell of a place.
    pub(super) fn node(&self, place_m: [f64; 2]) -> Result<NodeId, FlowsError> {
        let node = self.raster.cell(place_m).and_then(|cell| self.nodes[cell]);
        node.ok_or_else(|| FlowsError::Setting(format!("{place_m:?} is inside a wall")))
    }

    /// The begin and the end of an edge, metres.
    pub(super) fn ends_m(&self, edge: &Edge) -> [[f64; 2]; 2] {
        [edge.from, edge.to].map(|node| {
            let pose = self.topology.node(node).ok().and_then(|node| node.pose);
            pose.map_or([f64::NAN; 2], |pose| [pose.x_m, pose.y_m])
        })
    }

    /// The eight neighbours of a cell with their distances; diagonal ones only where both cells beside them are open.
    fn neighbours(&self, cell: usize) -> Vec<(usize, f64)> {
        let [width, height] = self.raster.counts.map(|count| count as i64);
        let (x, y) = (cell as i64 % width, cell as i64 / width);
        let open = |x: i64, y: i64| {
            let is_inside = (0..width).contains(&x) && (0..height).contains(&y);
            is_inside.then(|| (x + y * width) as usize).filter(|&cell| self.nodes[cell].is_some())
        };
        let mut found = Vec::new();
        for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))).filter(|step| *step != (0, 0)) {
            let is_clear = open(x + dx, y).is_some() && open(x, y + dy).is_some();
            if let Some(other) = open(x + dx, y + dy).filter(|_| is_clear) {
                found.push((other, CELL_M * ((dx * dx + dy * dy) as f64).sqrt()));
            }
        }
        found
    }
}
