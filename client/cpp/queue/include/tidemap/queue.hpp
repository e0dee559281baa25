// A producer whose observations wait in files of the robot until the daemon has them.
//
//   tidemap::QueueOptions options;
//   options.server = "10.0.0.5:7435";
//   options.map = "office";
//   options.producer = "robot-1";
//   options.folder = "/var/lib/robot/queue";
//   tidemap::QueuedProducer producer(options);      // does not wait for the daemon
//   producer.send("door", 1458518400000000000, 1);  // kept from here on
//
// Invariant: an observation whose call returned is in the files. It is sent exactly once, in order, also by the next
// run of the program. A call that throws has taken nothing. Calls may come from any thread.

#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "tidemap-cpp/src/lib.rs.h"

namespace tidemap {

// Why a call was not possible; what() states what to do.
class QueueError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// The queue has no room for the observation, which was not taken.
class QueueFull : public QueueError {
 public:
  using QueueError::QueueError;
};

// An argument is not valid.
class InvalidObservation : public QueueError {
 public:
  using QueueError::QueueError;
};

// Another program uses the folder.
class QueueInUse : public QueueError {
 public:
  using QueueError::QueueError;
};

// A file of the folder is damaged or missing.
class QueueDamaged : public QueueError {
 public:
  using QueueError::QueueError;
};

// The daemon does not have everything yet; the rest waits.
class StillWaiting : public QueueError {
 public:
  using QueueError::QueueError;
};

struct QueueOptions {
  std::string server = "127.0.0.1:7435";  // HOST:PORT, https://HOST:PORT or unix:PATH
  std::string token;
  std::string ca_file;           // certificate that the daemon's is checked by; https needs it
  std::string certificate_file;  // certificate and key of this client, if the daemon requires one
  std::string key_file;
  std::string map;
  std::string producer;  // the same across restarts
  std::string label;
  std::string folder;  // one for each map, producer and label
  std::uint64_t bytes_max = std::uint64_t{1} << 30;
  double sync_secs = 1.0;  // a power cut costs at most the newest observations of this time
};

// A pose in the map: metres, and a quaternion.
struct Pose {
  double x_m = 0, y_m = 0, z_m = 0;
  double qx = 0, qy = 0, qz = 0, qw = 1;
};

// A scan of a planar range finder, metres. Infinity, and max_range_m or more: the beam has no return; NaN: no reading.
// Beams without a return show that the way is free up to free_range_m (0: they show nothing); readings farther than
// trusted_range_m only show that the way is free up to it (0: all readings count).
struct RangeScan {
  Pose pose;
  std::string frame_id;  // frame of the pose; empty: the frame of the map
  float angle_min_rad = 0, angle_increment_rad = 0;
  float min_range_m = 0, max_range_m = 0, free_range_m = 0, trusted_range_m = 0;
  std::vector<float> ranges_m;
};

// Points in the frame of the sensor: x, y, z of each, metres.
struct PointCloud {
  Pose pose;
  std::string frame_id;
  float min_range_m = 0, max_range_m = 0;
  std::vector<float> xyz_m;
};

// A grid with a pose of its corner and a resolution of its own: rows along x; below 0 not seen, 0 free, above 0
// occupied.
struct OccupancyGrid {
  Pose pose;
  double resolution_m = 0;
  std::size_t width = 0;
  std::vector<std::int8_t> cells;
};

// An edge that was driven, or tried. Times are nanoseconds since 1970 UTC.
struct Traversal {
  std::string from, to, action;
  std::int64_t start_nanos = 0, end_nanos = 0;
  bool success = false;
  std::string reason;
};

// Counts since the queue was opened, unless stated otherwise.
struct QueueState {
  bool connected;
  std::string error;                  // why nothing is sent now; all is kept
  std::uint64_t last;                 // number of the last observation that was taken, ever
  std::uint64_t waiting;              // observations that the daemon does not have, also of earlier runs
  std::int64_t oldest_waiting_nanos;  // -1: none waits
  std::uint64_t bytes, bytes_max;
  std::uint64_t durable, refused;
  std::string last_refusal;
  std::uint64_t unreported;  // durable while the connection broke, so that refusals are unknown
  std::uint64_t unsendable;
  std::string last_unsendable;
  std::uint64_t not_taken;  // the queue was full, or the disk failed
  std::uint64_t lost;       // the daemon had them and no longer has them: a backup was restored
  std::uint64_t cut_bytes;  // an observation that was not written whole
};

// An observation that the daemon did not take; its number is used.
struct Refusal {
  std::uint64_t number;
  std::string reason;
  std::string detail;
};

class QueuedProducer {
 public:
  explicit QueuedProducer(const QueueOptions& options) : queue_(native::closed_queue()) {
    native::Options given{options.server,   options.token,    options.ca_file, options.certificate_file,
                          options.key_file, options.map,      options.producer, options.label,
                          options.folder,   options.bytes_max, options.sync_secs};
    checked(queue_->open(given));
  }

  // Takes an observation and returns its number in the queue.
  std::uint64_t send(std::string_view state, std::int64_t time_nanos, double value) {
    return checked(queue_->send(text(state), time_nanos, value));
  }

  // Takes the label of a categorical state that holds.
  std::uint64_t send_label(std::string_view state, std::int64_t time_nanos, std::string_view label) {
    return checked(queue_->send_label(text(state), time_nanos, text(label)));
  }

  // Takes a position: x and y, or x, y and z, metres.
  std::uint64_t send_position(std::string_view state, std::int64_t time_nanos, const std::vector<double>& coordinates) {
    return checked(queue_->send_position(text(state), time_nanos, slice(coordinates)));
  }

  std::uint64_t send_ranges(std::int64_t time_nanos, const RangeScan& scan) {
    return checked(queue_->send_ranges(time_nanos, place(scan.pose), text(scan.frame_id), scan.angle_min_rad,
                                       scan.angle_increment_rad, scan.min_range_m, scan.max_range_m,
                                       scan.free_range_m, scan.trusted_range_m, slice(scan.ranges_m)));
  }

  std::uint64_t send_cloud(std::int64_t time_nanos, const PointCloud& cloud) {
    return checked(queue_->send_cloud(time_nanos, place(cloud.pose), text(cloud.frame_id), cloud.min_range_m,
                                      cloud.max_range_m, slice(cloud.xyz_m)));
  }

  // The grid becomes cells of the map when the daemon has been reached.
  std::uint64_t send_occupancy(std::int64_t time_nanos, const OccupancyGrid& grid) {
    return checked(
        queue_->send_occupancy(time_nanos, place(grid.pose), grid.resolution_m, grid.width, slice(grid.cells)));
  }

  std::uint64_t send_traversal(const Traversal& driven) {
    return checked(queue_->send_traversal(text(driven.from), text(driven.to), text(driven.action), driven.start_nanos,
                                          driven.end_nanos, driven.success, text(driven.reason)));
  }

  // Takes a sighting of landmarks at a place: descriptors that were seen, and those that were out of view.
  std::uint64_t send_sighting(std::string_view place_name, std::int64_t time_nanos,
                              const std::vector<std::string>& seen, const std::vector<std::string>& out_of_view) {
    return checked(queue_->send_sighting(text(place_name), time_nanos, texts(seen), texts(out_of_view)));
  }

  QueueState state() const {
    auto found = queue_->counts();
    return {found.connected,
            std::string(found.error),
            found.last,
            found.waiting,
            found.oldest_waiting_nanos,
            found.bytes,
            found.bytes_max,
            found.durable,
            found.refused,
            std::string(found.last_refusal),
            found.unreported,
            found.unsendable,
            std::string(found.last_unsendable),
            found.not_taken,
            found.lost,
            found.cut_bytes};
  }

  // The refusals since the last call, at most 65,536.
  std::vector<Refusal> take_refusals() {
    std::vector<Refusal> found;
    for (const auto& one : queue_->take_refusals()) {
      found.push_back({one.number, std::string(one.reason), std::string(one.detail)});
    }
    return found;
  }

  // Tries to reach the daemon now, without the pause after a failure.
  void retry_now() { queue_->retry_now(); }

  // Forces everything that was taken to the disk: it survives a power cut from here on.
  void sync() { checked(queue_->sync()); }

  // Waits until the daemon has everything that was taken, and returns the number of the last. Throws StillWaiting.
  std::uint64_t flush(double patience_secs) { return checked(queue_->flush(patience_secs)); }

  // Ends sending, and forces everything to the disk; what waits is sent by the next run.
  void close() { checked(queue_->close()); }

 private:
  static std::uint64_t checked(const native::Reply& reply) {
    if (reply.problem == native::Problem::None) {
      return reply.number;
    }
    const std::string message(reply.message);
    switch (reply.problem) {
      case native::Problem::Full:
        throw QueueFull(message);
      case native::Problem::Invalid:
        throw InvalidObservation(message);
      case native::Problem::InUse:
        throw QueueInUse(message);
      case native::Problem::Damaged:
        throw QueueDamaged(message);
      case native::Problem::StillWaiting:
        throw StillWaiting(message);
      default:
        throw QueueError(message);
    }
  }

  // Throws std::invalid_argument if the text is not UTF-8.
  static rust::Str text(std::string_view given) { return rust::Str(given.data(), given.size()); }

  static rust::Vec<rust::String> texts(const std::vector<std::string>& given) {
    rust::Vec<rust::String> found;
    for (const auto& one : given) {
      found.push_back(rust::String(one));
    }
    return found;
  }

  template <typename T>
  static rust::Slice<const T> slice(const std::vector<T>& given) {
    return rust::Slice<const T>(given.data(), given.size());
  }

  static native::Position place(const Pose& pose) {
    return {pose.x_m, pose.y_m, pose.z_m, pose.qx, pose.qy, pose.qz, pose.qw};
  }

  rust::Box<native::Queue> queue_;
};

}  // namespace tidemap
