// The other side in tests: Fast DDS, the DDS of rmw_fastrtps, with samples that are serialized here.
//
// stream pub DOMAIN TOPIC COUNT RATE_HZ SIZE [best_effort|transient_local|keep_all]...
//     Waits for a reader, prints "matched", then publishes COUNT samples.
// stream sub DOMAIN TOPIC COUNT SECONDS SIZE [best_effort|transient_local|keep_all|until_left]...
//     Prints "ready", "matched" when a writer is found, then for each sample its number and how long it was under way,
//     in microseconds. Ends with 0 after COUNT samples, and with 3 after SECONDS; COUNT 0 receives until then. With
//     "until_left" it prints "left" and ends with 0 as soon as no writer is there any more.
//
// SIZE 0 is geometry_msgs/msg/Twist, more is sensor_msgs/msg/Image with so many bytes of data. Samples are those of
// stream.py. A transient-local publisher does not wait for a reader, and stays for 30 s. QoS is as ROS 2 has it by default: reliable, the last 10.
//
// With STREAM_ENCLAVE=DIRECTORY it takes part in DDS Security with the files of an enclave, named as SROS2 names them. What
// DDS does not let it do then, it says: "refused: …", and ends with 4.

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::Duration_t;
using eprosima::fastrtps::types::ReturnCode_t;
using Payload = eprosima::fastrtps::rtps::SerializedPayload_t;
using Clock = std::chrono::steady_clock;
using Bytes = std::vector<uint8_t>;

namespace {

constexpr size_t IMAGE_DATA = 52;

// Samples pass as they are: bytes of CDR with their header.
class Raw : public TopicDataType {
public:
    Raw(const char* name, size_t largest) {
        setName(name);
        m_typeSize = static_cast<uint32_t>(largest);
    }
    bool serialize(void* data, Payload* payload) override {
        const auto& bytes = *static_cast<Bytes*>(data);
        if (bytes.size() > payload->max_size) {
            return false;
        }
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(Payload* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, eprosima::fastrtps::rtps::InstanceHandle_t*, bool) override { return false; }
};

template <typename Value>
void put(Bytes& bytes, size_t at, Value value) {
    std::memcpy(bytes.data() + at, &value, sizeof value);
}

template <typename Value>
Value get(const Bytes& bytes, size_t at) {
    Value value;
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return value;
}

int64_t now() { return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch()).count(); }

// The number stands in the time stamp of an image, and in the first value of a Twist; the time of publishing in the data
// of an image, and in the second value of a Twist. In a Twist they are scaled, so that a gate lets them pass as speeds.
Bytes sample(uint32_t number, size_t size) {
    if (size == 0) {
        Bytes twist(4 + 6 * sizeof(double));
        twist[1] = 1;
        put(twist, 4, std::ldexp(number, -10));
        put(twist, 12, std::ldexp(now(), -60));
        return twist;
    }
    Bytes image(IMAGE_DATA + size, static_cast<uint8_t>(number % 251));
    std::memset(image.data(), 0, IMAGE_DATA);
    image[1] = 1;
    put(image, 4, number);
    put<uint32_t>(image, 12, 7);
    std::memcpy(image.data() + 16, "camera", 6);
    put<uint32_t>(image, 24, 1);
    put(image, 28, static_cast<uint32_t>(size));
    put<uint32_t>(image, 32, 6);
    std::memcpy(image.data() + 36, "mono8", 5);
    put(image, 44, static_cast<uint32_t>(size));
    put(image, 48, static_cast<uint32_t>(size));
    put(image, IMAGE_DATA, now());
    return image;
}

bool is_whole(const Bytes& bytes, uint32_t number, size_t size) {
    if (size == 0) {
        return bytes.size() == 4 + 6 * sizeof(double);
    }
    if (bytes.size() < IMAGE_DATA + size || get<uint32_t>(bytes, 48) != size) {
        return false;
    }
    for (size_t at = IMAGE_DATA + 8; at < IMAGE_DATA + size; ++at) {
        if (bytes[at] != number % 251) {
            return false;
        }
    }
    return true;
}

// The plugins of DDS Security, with the files of an enclave.
void secure(DomainParticipantQos& qos, const std::string& enclave) {
    auto& properties = qos.properties().properties();
    const auto file = [&](const char* name) { return "file://" + enclave + "/" + name; };
    const auto set = [&](const std::string& name, const std::string& value) {
        properties.emplace_back("dds.sec." + name, value);
    };
    set("auth.plugin", "builtin.PKI-DH");
    set("access.plugin", "builtin.Access-Permissions");
    set("crypto.plugin", "builtin.AES-GCM-GMAC");
    set("auth.builtin.PKI-DH.identity_ca", file("identity_ca.cert.pem"));
    set("auth.builtin.PKI-DH.identity_certificate", file("cert.pem"));
    set("auth.builtin.PKI-DH.private_key", file("key.pem"));
    set("access.builtin.Access-Permissions.permissions_ca", file("permissions_ca.cert.pem"));
    set("access.builtin.Access-Permissions.governance", file("governance.p7s"));
    set("access.builtin.Access-Permissions.permissions", file("permissions.p7s"));
}

int refused(const char* what) {
    std::cout << "refused: " << what << std::endl;
    return 4;
}

template <typename Qos>
void demand(Qos& qos, const std::set<std::string>& words) {
    const bool reliable = words.count("best_effort") == 0;
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    const bool latched = words.count("transient_local") != 0;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().kind = words.count("keep_all") == 0 ? KEEP_LAST_HISTORY_QOS : KEEP_ALL_HISTORY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
}

int publish(DataWriter* writer, uint32_t count, double rate, size_t size, const std::set<std::string>& words) {
    const bool latched = words.count("transient_local") != 0;
    PublicationMatchedStatus status;
    const auto deadline = Clock::now() + std::chrono::seconds(30);
    while (!latched && (writer->get_publication_matched_status(status), status.current_count == 0)) {
        if (Clock::now() > deadline) {
            std::cerr << "no reader within 30 s\n";
            return 1;
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    std::cout << "matched" << std::endl;
    const auto start = Clock::now();
    for (uint32_t number = 0; number < count; ++number) {
        std::this_thread::sleep_until(start + std::chrono::duration<double>(number / rate));
        Bytes bytes = sample(number, size);
        if (!writer->write(&bytes)) {
            std::cerr << "sample " << number << " was not written\n";
            return 1;
        }
    }
    if (latched) {
        std::this_thread::sleep_until(deadline);
    } else if (words.count("best_effort") == 0 && writer->wait_for_acknowledgments(Duration_t(20, 0)) != ReturnCode_t::RETCODE_OK) {
        std::cerr << "not all samples were acknowledged within 20 s\n";
        return 1;
    }
    return 0;
}

int subscribe(DataReader* reader, uint32_t count, double seconds, size_t size, const std::set<std::string>& words) {
    std::cout << "ready" << std::endl;
    const auto deadline = Clock::now() + std::chrono::duration<double>(seconds);
    uint32_t received = 0;
    bool matched = false;
    while (count == 0 || received < count) {
        if (Clock::now() > deadline) {
            return count == 0 ? 0 : 3;
        }
        SubscriptionMatchedStatus status;
        if (!matched && (reader->get_subscription_matched_status(status), status.current_count > 0)) {
            matched = true;
            std::cout << "matched" << std::endl;
        }
        if (matched && words.count("until_left") != 0 &&
            (reader->get_subscription_matched_status(status), status.current_count == 0)) {
            std::cout << "left" << std::endl;
            return 0;
        }
        if (!reader->wait_for_unread_message(Duration_t(0, 10'000'000))) {
            continue;
        }
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) {
                continue;
            }
            const auto came = now();
            const auto number = size == 0 ? static_cast<uint32_t>(std::ldexp(get<double>(bytes, 4), 10)) : get<uint32_t>(bytes, 4);
            const auto sent = size == 0 ? static_cast<int64_t>(std::ldexp(get<double>(bytes, 12), 60)) : get<int64_t>(bytes, IMAGE_DATA);
            if (!is_whole(bytes, number, size)) {
                std::cerr << "sample " << number << " is damaged\n";
                return 1;
            }
            // It may be there before DDS says that its writer is.
            if (!matched) {
                matched = true;
                std::cout << "matched" << std::endl;
            }
            ++received;
            std::cout << number << ' ' << (came - sent) / 1000 << std::endl;
        }
    }
    return 0;
}

} // namespace

int main(int argc, char** argv) {
    if (argc < 7) {
        std::cerr << "stream pub DOMAIN TOPIC COUNT RATE_HZ SIZE | sub DOMAIN TOPIC COUNT SECONDS SIZE\n";
        return 64;
    }
    const bool publishes = std::string(argv[1]) == "pub";
    const auto domain = static_cast<uint32_t>(std::stoul(argv[2]));
    const std::string name = argv[3];
    const auto count = static_cast<uint32_t>(std::stoul(argv[4]));
    const double rate_or_seconds = std::stod(argv[5]);
    const size_t size = std::stoul(argv[6]);
    const std::set<std::string> words(argv + 7, argv + argc);

    auto* factory = DomainParticipantFactory::get_instance();
    factory->load_profiles(); // as rmw_fastrtps does: the file that FASTRTPS_DEFAULT_PROFILES_FILE names
    DomainParticipantQos qos = factory->get_default_participant_qos();
    // Without multicast, others are looked for on this host.
    eprosima::fastrtps::rtps::Locator_t here(LOCATOR_KIND_UDPv4, 0);
    eprosima::fastrtps::rtps::IPLocator::setIPv4(here, 127, 0, 0, 1);
    qos.wire_protocol().builtin.initialPeersList.push_back(here);
    if (const char* enclave = std::getenv("STREAM_ENCLAVE")) {
        secure(qos, enclave);
    }
    auto* participant = factory->create_participant(domain, qos);
    if (participant == nullptr) {
        return refused("no participant");
    }
    TypeSupport type(new Raw(size == 0 ? "geometry_msgs::msg::dds_::Twist_" : "sensor_msgs::msg::dds_::Image_", IMAGE_DATA + size + 64));
    type.register_type(participant);
    auto* topic = participant->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
    if (publishes) {
        DataWriterQos writer_qos = DATAWRITER_QOS_DEFAULT;
        demand(writer_qos, words);
        auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, writer_qos);
        if (writer == nullptr) {
            return refused("no writer");
        }
        return publish(writer, count, rate_or_seconds, size, words);
    }
    DataReaderQos reader_qos = DATAREADER_QOS_DEFAULT;
    demand(reader_qos, words);
    auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, reader_qos);
    if (reader == nullptr) {
        return refused("no reader");
    }
    return subscribe(reader, count, rate_or_seconds, size, words);
}
