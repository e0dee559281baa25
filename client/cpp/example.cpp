// A client in C++: streams observations and takes acknowledgements, then requests a map and a route.
//
//   example HOST:PORT [PAUSE_MS]
//
// With a pause it observes slowly, so that the daemon can be stopped and started meanwhile.
//
// Invariant: an observation is kept until the daemon has acknowledged it. After a broken connection the stream
// continues after the last observation that the daemon has, so that each observation counts once.

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <deque>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "tidemap/v1/maintenance.grpc.pb.h"
#include "tidemap/v1/map.grpc.pb.h"
#include "tidemap/v1/observation.grpc.pb.h"
#include "tidemap/v1/query.grpc.pb.h"
#include "tidemap/v1/route.grpc.pb.h"
#include "tidemap/v1/topology.grpc.pb.h"

namespace wire = tidemap::v1;

namespace {

constexpr int64_t kSecond = 1'000'000'000;
constexpr int64_t kHour = 3600 * kSecond;
constexpr int64_t kMonday = 1'767'571'200 * kSecond;  // 2026-01-05T00:00:00Z
constexpr std::size_t kBatch = 256;

// Throws the message of the daemon if it refused something.
void check(const grpc::Status& status, const std::string& what) {
  if (!status.ok()) {
    throw std::runtime_error(what + ": " + status.error_message());
  }
}

google::protobuf::Timestamp timestamp(int64_t nanos) {
  google::protobuf::Timestamp found;
  found.set_seconds(nanos / kSecond);
  found.set_nanos(static_cast<int32_t>(nanos % kSecond));
  return found;
}

struct Observation {
  std::string state;
  int64_t time_nanos;
  double value;
};

// A producer that sends each observation exactly once. It is for one thread.
class Producer {
 public:
  Producer(const std::shared_ptr<grpc::Channel>& channel, std::string map, std::string name, std::string label)
      : stub_(wire::ObservationService::NewStub(channel)),
        map_(std::move(map)),
        name_(std::move(name)),
        label_(std::move(label)) {}

  // The first call reports which observations the daemon has already: number next() is the first to send.
  uint64_t next() {
    if (!stream_) {
      connect();
    }
    return first_kept_ + kept_.size();
  }

  // Keeps an observation until it is acknowledged.
  void give(Observation observation) {
    next();
    kept_.push_back(std::move(observation));
  }

  // Sends everything that is kept, and waits until it is on the daemon's disk, or refused. Tries again for a minute
  // where the daemon cannot be reached.
  void flush() {
    for (int attempt = 0; !kept_.empty(); ++attempt) {
      if (!stream_) {
        connect();
      }
      if (exchange()) {
        continue;
      }
      const grpc::Status status = finish();
      const bool is_passing = status.error_code() == grpc::StatusCode::UNAVAILABLE || status.ok();
      if (!is_passing || attempt >= 60) {
        check(status, "the stream of observations");
        throw std::runtime_error("the stream of observations ended");
      }
      std::this_thread::sleep_for(std::chrono::seconds(1));
    }
  }

  // Ends the stream; everything is acknowledged.
  void close() {
    flush();
    if (stream_) {
      stream_->WritesDone();
      wire::ObserveResponse reply;
      while (stream_->Read(&reply)) {
      }
      check(finish(), "the end of the stream");
    }
  }

  uint64_t refused() const { return refused_; }

 private:
  void connect() {
    context_ = std::make_unique<grpc::ClientContext>();
    context_->set_wait_for_ready(true);
    stream_ = stub_->Observe(context_.get());
    names_.clear();
    wire::ObserveRequest request;
    wire::Hello* hello = request.mutable_hello();
    hello->set_map(map_);
    hello->set_producer(name_);
    hello->set_label(label_);
    // 0 the first time: the daemon gives a number. If a Hello has the number of the Welcome, a stream that is still
    // open ends.
    hello->set_incarnation(incarnation_);
    wire::ObserveResponse reply;
    if (!stream_->Write(request) || !stream_->Read(&reply) || !reply.has_welcome()) {
      check(finish(), "the hello of the producer");
      throw std::runtime_error("the daemon did not say welcome");
    }
    incarnation_ = reply.welcome().incarnation();
    max_batch_ = reply.welcome().max_batch_observations();
    const uint64_t durable = reply.welcome().durable_sequence();
    if (first_kept_ == 0) {
      first_kept_ = durable + 1;
    } else if (durable + 1 < first_kept_ || durable >= first_kept_ + kept_.size()) {
      throw std::runtime_error("the daemon has other observations than were sent from here");
    }
    acknowledge(durable);
  }

  // Sends all that is kept in batches, each with its numbers, and reads until it is acknowledged. False: the connection
  // broke, or the daemon ended the stream.
  bool exchange() {
    const std::size_t limit = std::min<std::size_t>(kBatch, std::max<std::size_t>(max_batch_, 1));
    const uint64_t last = first_kept_ + kept_.size() - 1;
    for (std::size_t from = 0; from < kept_.size(); from += limit) {
      const std::size_t to = std::min(from + limit, kept_.size());
      wire::ObserveRequest request;
      wire::ObservationBatch* batch = request.mutable_batch();
      batch->set_first_sequence(first_kept_ + from);
      wire::ObservationColumns* columns = batch->mutable_observations();
      columns->set_first_time_nanos(kept_[from].time_nanos);
      int64_t before = kept_[from].time_nanos;
      for (std::size_t row = from; row < to; ++row) {
        const Observation& observation = kept_[row];
        columns->add_time_deltas(observation.time_nanos - before);
        before = observation.time_nanos;
        columns->add_state_indices(index(observation.state, columns));
        columns->add_values(observation.value);
      }
      if (!stream_->Write(request)) {
        return false;
      }
    }
    wire::ObserveResponse reply;
    while (first_kept_ <= last) {
      if (!stream_->Read(&reply)) {
        return false;
      }
      if (reply.has_ack()) {
        for (const wire::Refusal& refusal : reply.ack().refused()) {
          ++refused_;
          std::cerr << "observation " << refusal.sequence() << " was refused: " << refusal.detail() << "\n";
        }
        acknowledge(reply.ack().durable_sequence());
      } else if (reply.has_goodbye()) {
        acknowledge(reply.goodbye().durable_sequence());
        return false;
      }
    }
    return true;
  }

  // The index of a name in the table of the stream; a new one is sent along.
  uint32_t index(const std::string& name, wire::ObservationColumns* columns) {
    for (uint32_t at = 0; at < names_.size(); ++at) {
      if (names_[at] == name) {
        return at;
      }
    }
    names_.push_back(name);
    columns->add_new_states(name);
    return static_cast<uint32_t>(names_.size() - 1);
  }

  void acknowledge(uint64_t durable) {
    while (!kept_.empty() && first_kept_ <= durable) {
      kept_.pop_front();
      ++first_kept_;
    }
  }

  grpc::Status finish() {
    const grpc::Status status = stream_->Finish();
    stream_.reset();
    return status;
  }

  std::unique_ptr<wire::ObservationService::Stub> stub_;
  const std::string map_, name_, label_;
  std::unique_ptr<grpc::ClientContext> context_;
  std::unique_ptr<grpc::ClientReaderWriter<wire::ObserveRequest, wire::ObserveResponse>> stream_;
  std::vector<std::string> names_;
  std::deque<Observation> kept_;
  uint64_t first_kept_ = 0;  // Number of kept_[0]; 0: not known yet.
  uint64_t incarnation_ = 0;
  uint64_t refused_ = 0;
  uint32_t max_batch_ = 0;
};

// Makes a map with a grid and two nodes, where the daemon has none yet.
void make_map(const std::shared_ptr<grpc::Channel>& channel, const std::string& map) {
  auto maps = wire::MapService::NewStub(channel);
  wire::CreateMapRequest create;
  create.set_name(map);
  create.mutable_grid()->set_resolution_m(0.5);
  create.mutable_grid()->set_flat(true);
  wire::CreateMapResponse created;
  grpc::ClientContext create_context;
  const grpc::Status status = maps->CreateMap(&create_context, create, &created);
  if (status.error_code() != grpc::StatusCode::ALREADY_EXISTS) {
    check(status, "the map");
  }

  auto topology = wire::TopologyService::NewStub(channel);
  wire::LoadTopologyRequest load;
  load.set_map(map);
  for (const char* name : {"hall", "lab", "office"}) {
    load.add_nodes()->set_name(name);
  }
  const auto edge = [&load](const char* from, const char* to, double length_m) {
    wire::TopologyEdge* added = load.add_edges();
    added->mutable_ends()->set_from(from);
    added->mutable_ends()->set_to(to);
    added->mutable_ends()->set_both_ways(true);
    added->set_length_m(length_m);
  };
  edge("hall", "lab", 8.0);
  edge("lab", "office", 6.0);
  edge("hall", "office", 40.0);
  wire::LoadTopologyResponse loaded;
  grpc::ClientContext load_context;
  check(topology->LoadTopology(&load_context, load, &loaded), "the topology");
}

// Streams two weeks of a door; what the daemon has is not sent again.
void observe(const std::shared_ptr<grpc::Channel>& channel, const std::string& map, std::chrono::milliseconds pause) {
  Producer producer(channel, map, "robot-cpp", "doors");
  const uint64_t rows = 14 * 24 * 6;
  const uint64_t first = producer.next();
  for (uint64_t number = first; number <= rows; ++number) {
    const int64_t time_nanos = kMonday + static_cast<int64_t>(number - 1) * kHour / 6;
    const int64_t hour = time_nanos / kHour % 24;
    producer.give({"door", time_nanos, hour >= 8 && hour < 18 ? 1.0 : 0.0});
    if (number % 500 == 0) {
      producer.flush();
      std::this_thread::sleep_for(pause);
    }
  }
  producer.close();
  std::cout << "observations: " << rows << " durable, " << first - 1 << " of them before, " << producer.refused()
            << " refused\n";
}

// Sends a scan of a planar range finder, all around, in a stream of its own.
void scan(const std::shared_ptr<grpc::Channel>& channel, const std::string& map) {
  auto stub = wire::ObservationService::NewStub(channel);
  grpc::ClientContext context;
  auto stream = stub->Observe(&context);
  wire::ObserveRequest request;
  request.mutable_hello()->set_map(map);
  request.mutable_hello()->set_producer("robot-cpp");
  request.mutable_hello()->set_label("scans");
  wire::ObserveResponse reply;
  if (stream->Write(request) && stream->Read(&reply) && reply.has_welcome() &&
      reply.welcome().durable_sequence() == 0) {
    wire::ScanBatch* batch = request.mutable_scans();
    batch->set_first_sequence(1);
    batch->set_first_time_nanos(kMonday);
    batch->add_time_deltas(0);
    wire::RangeScan* ranges = batch->add_scans()->mutable_ranges();
    ranges->mutable_pose()->set_qw(1.0);
    ranges->set_angle_increment_rad(0.01F);
    ranges->set_max_range_m(20.0F);
    for (int ray = 0; ray < 628; ++ray) {
      ranges->add_ranges_m(5.0F);
    }
    stream->Write(request);
  }
  stream->WritesDone();
  while (stream->Read(&reply)) {
  }
  check(stream->Finish(), "the stream of scans");
}

// Learns now instead of at midnight, and waits until the job has ended.
void learn(const std::shared_ptr<grpc::Channel>& channel, const std::string& map) {
  auto stub = wire::MaintenanceService::NewStub(channel);
  wire::RunUpdateRequest request;
  request.set_map(map);
  wire::RunUpdateResponse response;
  grpc::ClientContext context;
  check(stub->RunUpdate(&context, request, &response), "the update");
  wire::WatchJobRequest watched;
  watched.set_id(response.job().id());
  grpc::ClientContext watch_context;
  auto replies = stub->WatchJob(&watch_context, watched);
  wire::WatchJobResponse reply;
  while (replies->Read(&reply)) {
  }
  check(replies->Finish(), "the update");
}

void predict(const std::shared_ptr<grpc::Channel>& channel, const std::string& map) {
  auto stub = wire::QueryService::NewStub(channel);
  wire::PredictStatesRequest request;
  request.set_map(map);
  request.add_states("door");
  request.add_times_nanos(kMonday + 15 * 24 * kHour + 12 * kHour);
  request.add_times_nanos(kMonday + 15 * 24 * kHour + 3 * kHour);
  grpc::ClientContext context;
  auto replies = stub->PredictStates(&context, request);
  wire::PredictStatesResponse reply;
  while (replies->Read(&reply)) {
    if (reply.probabilities_size() == 2) {
      std::cout << "door at noon " << (reply.probabilities(0) > 0.5 ? "open" : "closed") << ", at night "
                << (reply.probabilities(1) > 0.5 ? "open" : "closed") << "\n";
    }
  }
  check(replies->Finish(), "the prediction");
}

void ask_for_map(const std::shared_ptr<grpc::Channel>& channel, const std::string& map) {
  auto stub = wire::QueryService::NewStub(channel);
  wire::PredictGridRequest request;
  request.set_map(map);
  *request.mutable_time() = timestamp(kMonday + 15 * 24 * kHour);
  request.set_project(true);
  grpc::ClientContext context;
  auto replies = stub->PredictGrid(&context, request);
  wire::PredictGridResponse reply;
  uint64_t cells = 0;
  double resolution_m = 0;
  while (replies->Read(&reply)) {
    if (reply.has_header()) {
      resolution_m = reply.header().grid().resolution_m();
    }
    for (const wire::PredictedTile& tile : reply.page().tiles()) {
      for (const char byte : tile.known()) {
        cells += static_cast<uint64_t>(__builtin_popcount(static_cast<unsigned char>(byte)));
      }
    }
  }
  check(replies->Finish(), "the map");
  std::cout << "map: " << cells << " known cells of " << resolution_m << " m\n";
}

void ask_for_route(const std::shared_ptr<grpc::Channel>& channel, const std::string& map) {
  auto stub = wire::RouteService::NewStub(channel);
  wire::PlanRouteRequest request;
  request.set_map(map);
  request.set_from("hall");
  request.set_to("office");
  request.set_objective(wire::ROUTE_OBJECTIVE_TIME);
  request.set_recovery_secs(0.0);
  *request.mutable_depart_time() = timestamp(kMonday + 15 * 24 * kHour);
  wire::PlanRouteResponse response;
  grpc::ClientContext context;
  check(stub->PlanRoute(&context, request, &response), "the route");
  if (response.routes_size() == 0) {
    throw std::runtime_error("there is no route");
  }
  std::cout << "route: hall";
  for (const wire::RouteStep& step : response.routes(0).steps()) {
    std::cout << " -> " << step.edge().to();
  }
  std::cout << "\n";
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 2 && count != 3) {
    std::cerr << "usage: example HOST:PORT [PAUSE_MS]\n";
    return 2;
  }
  try {
    const std::chrono::milliseconds pause(count == 3 ? std::stoi(arguments[2]) : 0);
    const auto channel = grpc::CreateChannel(arguments[1], grpc::InsecureChannelCredentials());
    const std::string map = "cpp";
    make_map(channel, map);
    observe(channel, map, pause);
    scan(channel, map);
    learn(channel, map);
    predict(channel, map);
    ask_for_map(channel, map);
    ask_for_route(channel, map);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
